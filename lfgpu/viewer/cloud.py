"""A disparity map as points in space, coloured as the reference view sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.geometry import Geometry
from lfgpu.viz.figures import scale_limits

MOST_POINTS = 300_000
"""More are not sent to a browser: every second, third ... pixel of each row and column is."""

_MARGIN = 0.5  # of the range of disparities or depths but for outliers: what lies farther beyond is left out
_RELIEF = 0.5  # of the picture's longer side: how deep all disparities together are drawn without metres


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in the frame of the reference camera: x to the right, y down, z away from it."""

    points: NDArray[np.float32]
    """[p, 3], metres, or with `metric` False the picture's longer side is 1 and the disparity is depth."""
    colours: NDArray[np.uint8]
    """[p, 3]"""
    pixels: NDArray[np.int32]
    """[p, 2], (x, y) of each point in the reference view."""
    spacing: float
    """Distance of neighbouring points in the middle of the cloud."""
    metric: bool
    fov: float
    """Vertical angle that the reference view spans, radians."""

    @property
    def centre(self) -> NDArray[np.float64]:
        """The median of the points."""
        return np.median(self.points, axis=0).astype(np.float64) if len(self.points) else np.array([0.0, 0.0, 1.0])


def point_cloud(
    disparity: NDArray[np.float32],
    colours: NDArray[np.uint8],
    geometry: Geometry | None,
    *,
    confidence: NDArray[np.float32] | None = None,
    least_confidence: float = 0.0,
    most_points: int = MOST_POINTS,
) -> Cloud:
    """The points of a disparity map.

    Parameters
    ----------
    disparity
        float32 [y, x], pixels per view step; undefined pixels have no point, nor have a few outliers.
    colours
        uint8 [y, x, 3], those of the points.
    geometry
        What gives metres; None for points whose depth is the disparity itself.
    confidence, least_confidence
        Pixels of a smaller confidence have no point.
    most_points
        See `MOST_POINTS`.
    """
    height, width = disparity.shape
    step = max(1, int(np.ceil(np.sqrt(disparity.size / most_points))))
    y, x = np.mgrid[0:height:step, 0:width:step]
    d = disparity[::step, ::step]
    keep = np.isfinite(d)
    if confidence is not None:
        keep &= ~(confidence[::step, ::step] < least_confidence)
    cx, cy = (width - 1) / 2, (height - 1) / 2
    if geometry is None:
        low, high = scale_limits(d)
        longest = max(height, width)
        z = 1.0 + _RELIEF * ((low + high) / 2 - d) / max(high - low, 1e-6)
        across, down, unit = (x - cx) / longest, (y - cy) / longest, 1.0 / longest
        fov = 2 * np.arctan(height / longest / 2)
        keep &= (d >= low - _MARGIN * (high - low)) & (d <= high + _MARGIN * (high - low))
    else:
        cx, cy = geometry.principal_point or (cx, cy)
        z = geometry.depth(d).astype(np.float32)
        keep &= np.isfinite(z)
        near, far = scale_limits(z)
        keep &= z <= far + _MARGIN * (far - near)
        z = np.where(keep, z, 0)
        f = geometry.focal_length_px
        across, down, unit = (x - cx) / f * z, (y - cy) / f * z, float(np.median(z[keep])) / f if keep.any() else 1.0
        fov = 2 * np.arctan(height / 2 / f)
    points = np.stack([across[keep], down[keep], z[keep]], axis=-1).astype(np.float32)
    pixels = np.stack([x[keep], y[keep]], axis=-1).astype(np.int32)
    return Cloud(points, colours[::step, ::step][keep], pixels, unit * step, geometry is not None, float(fov))


def nearest_to_ray(cloud: Cloud, origin: Any, direction: Any) -> tuple[int, int] | None:
    """(x, y) of the pixel whose point a ray meets first, within two spacings of it; None if it meets none."""
    towards = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    relative = cloud.points - np.asarray(origin, np.float64)
    along = relative @ towards
    beside = np.linalg.norm(relative - along[:, None] * towards, axis=1)
    met = np.flatnonzero((along > 0) & (beside < 2 * cloud.spacing))
    if not met.size:
        return None
    x, y = cloud.pixels[met[np.argmin(along[met] + beside[met])]]
    return int(x), int(y)
