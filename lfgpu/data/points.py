"""Point clouds from disparity maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.contract import Float32Array
from lfgpu.data.light_field_checks import check_number, check_whole
from lfgpu.data.result import DepthResult, DisparityMap, check_result
from lfgpu.errors import LightFieldError


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A point cloud, with one point for each pixel of finite depth.

    Parameters
    ----------
    points
        float32 [n, 3]. With a geometry: metres to the right, down and forward from the camera that `Geometry.points`
        names. Without one: pixels to the right of and below the image centre, and -disparity in pixels per view step.
        In both cases farther points have a larger third coordinate.
    colors
        uint8 [n, 3], red, green and blue; None without an image.
    confidence
        float32 [n], 0 to 1; None if the map has none.
    pixels
        int64 [n, 2], (column, row) of the pixel of each point.
    metric
        Whether the points are in metres.
    """

    points: Float32Array
    colors: NDArray[np.uint8] | None
    confidence: Float32Array | None
    pixels: NDArray[np.int64]
    metric: bool

    def __repr__(self) -> str:
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        box = ", ".join(f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True))
        known = [name for name in ("colors", "confidence") if getattr(self, name) is not None]
        return (
            f"<PointCloud of {len(self.points)} points, {'metres' if self.metric else 'pixels, z is -disparity'}\n "
            f"{box}; {' and '.join(['pixels', *known])} of each>"
        )


def point_cloud(
    result: DepthResult | DisparityMap,
    *,
    image: ArrayLike | None = None,
    least_confidence: float = 0.0,
    step: int = 1,
) -> PointCloud:
    """Make a point cloud from a disparity map, in metres if its geometry is known.

    Parameters
    ----------
    result
        A result or a map.
    image
        The view that gives the colours: [y, x, c] or [y, x], c = 1 or 3, uint8, uint16 or float in [0, 1]. Default
        None: no colours.
    least_confidence
        Pixels with a lower confidence are left out; 0 (default) to 1.
    step
        Only every `step`-th pixel of each row and column has a point, >= 1. Default 1.

    Raises
    ------
    LightFieldError
        If the result is none, the image is not of the map's size, a number is out of its range, or no pixel is left.

    Examples
    --------
    >>> lfgpu.point_cloud(result, image=lf.image(lf.reference_index)).points.shape
    (5120, 3)
    """
    check_result(result, DisparityMap)
    check_whole("step", step, 1)
    check_number("least_confidence", least_confidence, 0, 1)
    disparity, every = result.disparity, np.s_[::step, ::step]
    height, width = disparity.shape
    y, x = np.mgrid[0:height:step, 0:width:step]
    if result.geometry is None:
        grid = np.stack([x - (width - 1) / 2, y - (height - 1) / 2, -disparity[every].astype(np.float64)], axis=-1)
    else:
        grid = result.geometry.points(disparity, position=result.position, step=step)
    kept = np.isfinite(grid).all(axis=2)
    confidence = None if result.confidence is None else result.confidence[every]
    if least_confidence > 0 and confidence is not None:
        kept &= confidence >= least_confidence
    if not kept.any():
        raise LightFieldError(
            "no pixel of the map has a finite depth and enough confidence, so the point cloud is empty; lower "
            "least_confidence."
        )
    colors = None if image is None else _colors(np.asarray(image), (height, width))[every][kept]
    return PointCloud(
        grid[kept].astype(np.float32),
        colors,
        None if confidence is None else confidence[kept],
        np.stack([x[kept], y[kept]], axis=1).astype(np.int64),
        result.geometry is not None,
    )


def _colors(image: NDArray[Any], size: tuple[int, int]) -> NDArray[np.uint8]:
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[:2] != size or image.shape[2] not in (1, 3):
        raise LightFieldError(
            f"the image must be [y, x], [y, x, 1] or [y, x, 3] of {size[0]} x {size[1]} pixels; found {image.shape}."
        )
    if image.dtype.kind == "f":
        image = np.rint(255 * np.clip(image, 0, 1))
    elif image.dtype == np.uint16:
        image = np.rint(image / 257)
    elif image.dtype != np.uint8:
        raise LightFieldError(f"the image must be uint8, uint16 or float; found {image.dtype}.")
    return np.broadcast_to(image, (*size, 3)).astype(np.uint8)
