"""Disparity and metric depth: the geometry of parallel cameras whose frames are shifted onto a focus plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.errors import LightFieldError


@dataclass(frozen=True)
class Geometry:
    """Cameras side by side with parallel axes, their frames shifted so that one plane has disparity 0.

    A point at depth Z (metres along the optical axis) has the disparity

        d = baseline_m * focal_length_px * (1 / Z - 1 / focus_distance_m)      [pixels per view step]

    which is how the HCI 4D Light Field Benchmark defines it (Honauer et al., ACCV 2016). It is counted in columns of
    pixels. Cameras whose rows stand closer or farther than their columns, and pixels that are not square, do not change
    it: a camera's position (u, v) tells both, see `positions`.

    Parameters
    ----------
    focal_length_px
        Focal length in widths of pixels, > 0.
    baseline_m
        Distance of neighbouring cameras of a row (one unit of a view's position) in metres, > 0.
    focus_distance_m
        Depth of the plane of disparity 0 in metres, > 0; infinity for frames that are not shifted.
    principal_point
        Where the optical axis meets the image of the camera whose frame is not shifted, (x, y) in pixels; None is the
        middle of the image.
    pixel_aspect
        Width of a pixel over its height, > 0: focal_length_px * pixel_aspect is the focal length in heights of pixels.
    unshifted_at
        Position (u, v), as in `LightField.positions`, of the camera whose frame is not shifted; None takes the one that
        a map belongs to. It makes no difference for depth, nor for anything if `focus_distance_m` is infinite.

    Raises
    ------
    LightFieldError
        If a length or the aspect is not a positive number, or a place no pair of finite numbers.
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
            if not value > 0 or (name != "focus_distance_m" and not np.isfinite(value)):
                raise LightFieldError(f"geometry: {name} must be a positive number, not {value}.")
        for name in ("principal_point", "unshifted_at"):
            place = getattr(self, name)
            if place is not None and (np.shape(place) != (2,) or not np.isfinite(place).all()):
                raise LightFieldError(f"geometry: {name} must be two finite numbers, not {place}.")

    def depth(self, disparity: ArrayLike) -> NDArray[np.float64]:
        """Depth in metres of a disparity in pixels per view step; infinity at or beyond the horizon, NaN of NaN."""
        inverse = np.asarray(disparity, np.float64) / (self.baseline_m * self.focal_length_px)
        inverse = inverse + 1.0 / self.focus_distance_m
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(inverse <= 0, np.inf, 1.0 / np.maximum(inverse, 0.0)))

    def disparity(self, depth_m: ArrayLike) -> NDArray[np.float64]:
        """Disparity in pixels per view step of a depth in metres; the inverse of `depth`."""
        inverse = 1.0 / np.asarray(depth_m, np.float64) - 1.0 / self.focus_distance_m
        return np.asarray(self.baseline_m * self.focal_length_px * inverse)

    def positions(self, centres_m: ArrayLike) -> NDArray[np.float64]:
        """Positions (u, v) in view steps, [n, 2], of cameras that stand at (right, down) in metres, [n, 2].

        Both are in units of what moves an image as one baseline does, so that one disparity holds for both directions:
        u = right / baseline_m and v = pixel_aspect * down / baseline_m.
        """
        return _pairs("centres", centres_m) * (1.0, self.pixel_aspect) / self.baseline_m

    def centres(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Where cameras stand, (right, down) in metres, [n, 2]; the inverse of `positions`."""
        return _pairs("positions", positions) * self.baseline_m / (1.0, self.pixel_aspect)

    def points(
        self, disparity: ArrayLike, *, position: tuple[float, float] | None = None, step: int = 1
    ) -> NDArray[np.float64]:
        """The points in space that the pixels of a disparity map show.

        Parameters
        ----------
        disparity
            [y, x], pixels per view step, of all pixels of a view.
        position
            (u, v) of that view; None is that of `unshifted_at`, or if that is None too, any.
        step
            Only every `step`-th pixel of each row and column is computed. Default 1.

        Returns
        -------
        float64 [y, x, 3] in metres: right, down and away from the camera at `unshifted_at` (or at `position`, where
        that is None), so that the points of all views of one light field are in one frame. NaN where the disparity is
        undefined or at or beyond the horizon.

        With (u, v) counted from there, a pixel's column is x = cx + f X / Z - d u: the frame of a camera that stands u
        steps to the right is shifted by u b f / F.
        """
        values = np.asarray(disparity, np.float64)
        if values.ndim != 2:
            raise LightFieldError(f"geometry: a disparity map must be [y, x], found shape {values.shape}.")
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
        """Where the camera at a position (u, v) stands in the frame of `points`, float64 [3], metres right, down, away.

        It is (0, 0, 0) for a position of None, and for all where `unshifted_at` is None.
        """
        right, down = self.centres([self._steps_from_unshifted(position)])[0]
        return np.array([right, down, 0.0])

    def _steps_from_unshifted(self, position: tuple[float, float] | None) -> tuple[float, float]:
        if position is None or self.unshifted_at is None:
            return 0.0, 0.0
        return position[0] - self.unshifted_at[0], position[1] - self.unshifted_at[1]


def _pairs(name: str, values: ArrayLike) -> NDArray[np.float64]:
    pairs = np.asarray(values, np.float64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise LightFieldError(f"geometry: {name} must be [n, 2], found shape {pairs.shape}.")
    return pairs
