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

    which is how the HCI 4D Light Field Benchmark defines it (Honauer et al., ACCV 2016).

    Parameters
    ----------
    focal_length_px
        Focal length in pixels, > 0.
    baseline_m
        Distance of neighbouring cameras (one unit of a view's position) in metres, > 0.
    focus_distance_m
        Depth of the plane of disparity 0 in metres, > 0; infinity for frames that are not shifted.
    principal_point
        Where the optical axis meets the image, (x, y) in pixels; None is the middle of the image.

    Raises
    ------
    LightFieldError
        If a length is not a positive number.
    """

    focal_length_px: float
    baseline_m: float
    focus_distance_m: float = float("inf")
    principal_point: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("focal_length_px", "baseline_m", "focus_distance_m"):
            value = getattr(self, name)
            if not value > 0 or (name != "focus_distance_m" and not np.isfinite(value)):
                raise LightFieldError(f"geometry: {name} must be a positive number, not {value}.")

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
