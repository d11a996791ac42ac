"""The geometry of parallel cameras, which relates disparity to metric depth."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data.light_field_checks import array_of_numbers, check_whole
from lfgpu.errors import LightFieldError

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Units of lengths, in metres."""


@dataclass(frozen=True)
class Geometry:
    """Parallel cameras in one plane. Their frames are shifted so that points at the focus distance have disparity 0.

    A point at depth Z (metres along the optical axis) has the disparity

        d = baseline_m * focal_length_px * (1 / Z - 1 / focus_distance_m)      [pixels per view step]

    as in the HCI 4D Light Field Benchmark (Honauer et al., ACCV 2016). Disparity is measured in pixel widths. It does
    not depend on the vertical spacing of the cameras or on the pixel aspect, because the position v of a camera
    accounts for both; see `positions`.

    Parameters
    ----------
    focal_length_px
        Focal length in pixel widths, > 0.
    baseline_m
        Distance between neighbouring cameras of a row (one view step) in metres, > 0.
    focus_distance_m
        Depth of the plane of disparity 0 in metres, > 0. Default infinity: the frames are not shifted.
    principal_point
        Principal point (x, y) in pixels of the camera whose frame is not shifted. Default None: the image centre.
    pixel_aspect
        Width of a pixel divided by its height, > 0; default 1. focal_length_px * pixel_aspect is the focal length in
        pixel heights.
    unshifted_at
        Position (u, v), as in `LightField.positions`, of the camera whose frame is not shifted. Default None: the
        camera that a map belongs to. It does not affect depth. It has no effect if `focus_distance_m` is infinite.

    Raises
    ------
    LightFieldError
        If a length or the aspect is not a positive number, or a point is not two finite numbers.

    Examples
    --------
    >>> cameras = lfgpu.Geometry(focal_length_px=500.0, baseline_m=0.02, focus_distance_m=4.0)
    >>> cameras.depth([0.0, 2.5]).tolist()
    [4.0, 2.0]
    """

    focal_length_px: float
    baseline_m: float
    focus_distance_m: float = float("inf")
    principal_point: tuple[float, float] | None = None
    pixel_aspect: float = 1.0
    unshifted_at: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("focal_length_px", "baseline_m", "focus_distance_m", "pixel_aspect"):
            value = getattr(self, name)
            if (
                not isinstance(value, Real)
                or not float(value) > 0
                or (name != "focus_distance_m" and not np.isfinite(float(value)))
            ):
                raise LightFieldError(f"geometry: {name} must be a positive number, not {value!r:.60}.")
        for name in ("principal_point", "unshifted_at"):
            place = getattr(self, name)
            if place is None:
                continue
            if np.shape(place) != (2,) or not all(
                isinstance(part, Real) and np.isfinite(float(part)) for part in place
            ):
                raise LightFieldError(f"geometry: {name} must be two finite numbers, not {place!r:.60}.")

    def depth(self, disparity: ArrayLike) -> NDArray[np.float64]:
        """Depth in metres of a disparity in pixels per view step; infinity at or beyond the horizon, NaN for NaN."""
        inverse = array_of_numbers("disparity", disparity, np.float64) / (self.baseline_m * self.focal_length_px)
        inverse = inverse + 1.0 / self.focus_distance_m
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(inverse <= 0, np.inf, 1.0 / np.maximum(inverse, 0.0)))

    def disparity(self, depth_m: ArrayLike) -> NDArray[np.float64]:
        """Disparity in pixels per view step of a depth in metres; the inverse of `depth`."""
        inverse = 1.0 / array_of_numbers("depth_m", depth_m, np.float64) - 1.0 / self.focus_distance_m
        return np.asarray(self.baseline_m * self.focal_length_px * inverse)

    def positions(self, centres_m: ArrayLike) -> NDArray[np.float64]:
        """Positions (u, v) [n, 2] in view steps of cameras at (right, down) [n, 2] in metres.

        u = right / baseline_m and v = pixel_aspect * down / baseline_m; so one disparity holds for both directions.
        """
        return _pairs("centres", centres_m) * (1.0, self.pixel_aspect) / self.baseline_m

    def centres(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Camera centres (right, down) [n, 2] in metres; the inverse of `positions`."""
        return _pairs("positions", positions) * self.baseline_m / (1.0, self.pixel_aspect)

    def points(
        self, disparity: ArrayLike, *, position: tuple[float, float] | None = None, step: int = 1
    ) -> NDArray[np.float64]:
        """Compute the 3D points of the pixels of a disparity map.

        Parameters
        ----------
        disparity
            [y, x], pixels per view step, of a whole view.
        position
            (u, v) of that view. Default None: `unshifted_at`.
        step
            Only every `step`-th pixel of each row and column is computed. Default 1.

        Returns
        -------
        float64 [y, x, 3] in metres: right, down and forward from the camera at `unshifted_at`, or at `position` if that
        is None. So the points of all views of a light field are in one coordinate frame. NaN where the disparity is
        undefined, or at or beyond the horizon.

        With (u, v) counted from that camera, the column of a pixel is x = cx + f X / Z - d u, because the frame of a
        camera u steps to the right is shifted by u b f / F.
        """
        values = array_of_numbers("disparity", disparity, np.float64)
        check_whole("step", step, 1)
        if values.ndim != 2:
            raise LightFieldError(f"geometry: a disparity map must be [y, x]; found shape {values.shape}.")
        height, width = values.shape
        cx, cy = self.principal_point or ((width - 1) / 2, (height - 1) / 2)
        u, v = self._steps_from_unshifted(position)
        values = values[::step, ::step]
        z = self.depth(values)
        z = np.where(np.isinf(z), np.nan, z)
        y, x = np.mgrid[0:height:step, 0:width:step]
        across = (x - cx + values * u) * z / self.focal_length_px
        down = (y - cy + values * v) * z / (self.focal_length_px * self.pixel_aspect)
        return np.stack([across, down, z], axis=-1)

    def camera(self, position: tuple[float, float] | None) -> NDArray[np.float64]:
        """Return the place of the camera at a position (u, v) in the frame of `points`, float64 [3], metres right,
        down, away.

        It is (0, 0, 0) for a position of None, and for all where `unshifted_at` is None.
        """
        right, down = self.centres([self._steps_from_unshifted(position)])[0]
        return np.array([right, down, 0.0])

    def _steps_from_unshifted(self, position: tuple[float, float] | None) -> tuple[float, float]:
        if position is None or self.unshifted_at is None:
            return 0.0, 0.0
        return position[0] - self.unshifted_at[0], position[1] - self.unshifted_at[1]


def usual_gap(places: NDArray[np.float64]) -> float:
    """Measure the median distance of places [n, 2] from their nearest neighbours."""
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(axis=1)))


def _pairs(name: str, values: ArrayLike) -> NDArray[np.float64]:
    pairs = array_of_numbers(name, values, np.float64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise LightFieldError(f"geometry: {name} must be [n, 2]; found shape {pairs.shape}.")
    return pairs
