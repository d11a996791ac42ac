"""The points of a disparity map as the page shows them: not too many, no outliers, and of a size that fits."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import DisparityMap, point_cloud
from lfgpu.errors import LightFieldError
from lfgpu.viz.scales import scale_limits

MOST_POINTS = 300_000
"""More are not sent to a browser: every second, third ... pixel of each row and column is."""

_MARGIN = 0.5  # of the range of disparities or depths but for outliers: what lies farther beyond is left out
_EDGE = 0.06  # of the range of disparities: neighbours that differ by more are not connected
_RELIEF = 0.5  # of the picture's longer side: how deep all disparities together are drawn without metres


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points as the page shows them: x to the right, y down, z away from the camera."""

    points: NDArray[np.float32]
    """[p, 3], the metres of `lfgpu.point_cloud`; without a geometry the picture's longer side is 1 and its middle at
    (0, 0, 1), and z falls with the disparity."""
    colours: NDArray[np.uint8]  # [p, 3]
    pixels: NDArray[np.int64]  # [p, 2], (x, y) of each point in the reference view
    spacing: float  # distance of neighbouring points in the middle of the cloud
    metric: bool  # true if the points are in metres
    eye: NDArray[np.float64]  # [3], where the camera stands that sees the map
    step: int  # every so many rows and columns of the map have points

    @property
    def centre(self) -> NDArray[np.float64]:
        """The median of the points; one unit before the eye if there are none."""
        if not len(self.points):
            return self.eye + np.array([0.0, 0.0, 1.0])
        return np.median(self.points, axis=0).astype(np.float64)


def shown_cloud(
    values: DisparityMap,
    colours: NDArray[np.uint8],
    *,
    least_confidence: float = 0.0,
    most_points: int = MOST_POINTS,
) -> Cloud:
    """Choose the points of a map, those of `lfgpu.point_cloud` without a few outliers and those between surfaces.

    A map without a geometry has points whose depth is the disparity itself. Pixels of a smaller confidence have none.
    """
    step = max(1, int(np.ceil(np.sqrt(values.disparity.size / most_points))))
    geometry, disparity = values.geometry, values.disparity[::step, ::step]
    eye = np.zeros(3) if geometry is None else geometry.camera(values.position)
    try:
        kept = replace(values, disparity=_cut(values.disparity))
        cloud = point_cloud(kept, image=colours, least_confidence=least_confidence, step=step)
    except LightFieldError:  # no pixel is left; colours are of the map's size
        points, colours, pixels = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros((0, 2), np.int64)
        return Cloud(points, colours, pixels, 1.0, geometry is not None, eye, step)
    assert cloud.colors is not None
    points = cloud.points
    if geometry is None:
        low, high = scale_limits(-disparity)
        margin, longest = _MARGIN * (high - low), max(values.disparity.shape)
        keep = (points[:, 2] >= low - margin) & (points[:, 2] <= high + margin)
        depth = 1 + _RELIEF * (points[:, 2] - (low + high) / 2) / max(high - low, 1e-6)
        points = np.stack([points[:, 0] / longest, points[:, 1] / longest, depth], axis=1).astype(np.float32)
        spacing = step / longest
    else:
        near, far = scale_limits(geometry.depth(disparity).astype(np.float32))
        keep = points[:, 2] <= far + _MARGIN * (far - near)
        spacing = step * float(np.median(points[keep, 2])) / geometry.focal_length_px
    return Cloud(points[keep], cloud.colors[keep], cloud.pixels[keep], spacing, cloud.metric, eye, step)


def _cut(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Leave out pixels halfway down a step of their row or column: they lie between two surfaces."""
    low, high = scale_limits(disparity)
    between = np.zeros(disparity.shape, np.bool_)
    for values, found in ((disparity, between), (disparity.T, between.T)):
        steps = np.diff(values, axis=1)
        for sign in (1, -1):
            apart = sign * steps > _EDGE * (high - low)  # NaN is not
            found[:, 1:-1] |= apart[:, 1:] & apart[:, :-1]
    return np.where(between, np.float32(np.nan), disparity)


def surface(cloud: Cloud, disparity: NDArray[np.float32]) -> NDArray[np.int64]:
    """Span triangles [n, 3] between neighbouring points of a cloud, none across an edge of depth.

    An edge is where the disparity [y, x] of neighbours differs by more than a small part of its range.
    """
    if not len(cloud.pixels):
        return np.zeros((0, 3), np.int64)
    places = np.full(disparity.shape, -1, np.int64)
    x, y = cloud.pixels.T
    places[y, x] = np.arange(len(x))
    index, values = places[:: cloud.step, :: cloud.step], disparity[:: cloud.step, :: cloud.step]
    low, high = scale_limits(disparity)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    corners = np.stack([values[:-1, :-1], values[:-1, 1:], values[1:, :-1], values[1:, 1:]])
    whole = (np.stack([a, b, c, d]) >= 0).all(axis=0)
    with np.errstate(invalid="ignore"):
        whole &= np.ptp(corners, axis=0) <= _EDGE * (high - low)  # NaN is not
    return np.concatenate([np.stack([a, c, b], axis=-1)[whole], np.stack([b, c, d], axis=-1)[whole]])


def nearest_to_ray(cloud: Cloud, origin: Any, direction: Any) -> tuple[int, int] | None:
    """Find (x, y) of the pixel whose point a ray meets first, within two spacings of it; None if it meets none."""
    towards = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    relative = cloud.points - np.asarray(origin, np.float64)
    along = relative @ towards
    beside = np.linalg.norm(relative - along[:, None] * towards, axis=1)
    met = np.flatnonzero((along > 0) & (beside < 2 * cloud.spacing))
    if not met.size:
        return None
    x, y = cloud.pixels[met[np.argmin(along[met] + beside[met])]]
    return int(x), int(y)
