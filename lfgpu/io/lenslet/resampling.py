"""From the sensor to views: the same point under every microlens is a view, on a hexagonal grid that is made square."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.lenslet.lattice import Microlenses
from lfgpu.io.lenslet.vignetting import Float32Array

LEAST_SIZE = 8
"""Pixels along the shorter side of a view below which a capture is refused."""

_SMALL_ANGLE = 0.7  # cosine of twice the angle
_TAPS = 4  # of the cubic interpolation along a row of lenses


@dataclass(frozen=True, eq=False)
class ViewGrid:
    """The pixels of the views on the sensor: a row for each row of lenses, and as far apart along it.

    So pixels are square, no row is interpolated, and along the rows, where lenses are farther apart than rows are by
    2 / sqrt(3), nothing is lost either. Rows and columns follow the rows of lenses, not the sides of the sensor.
    """

    lenses: Microlenses
    origin: NDArray[np.float64]  # [2], (x, y) on the sensor of the pixel at the top left
    shape: tuple[int, int]  # (height, width) in pixels
    first_row: int  # row of lenses of the first row of pixels

    @property
    def pixel(self) -> float:
        """Side of a pixel, in pixels of the sensor."""
        return self.lenses.row_distance


def view_grid(lenses: Microlenses, shape: tuple[int, ...], reach: float, *, name: str) -> ViewGrid:
    """Find the largest grid of view pixels that a sensor [y, x] holds, with `reach` pixels around all of them."""
    height, width = (side - 1 - 2 * reach for side in shape)
    c, s = abs(math.cos(lenses.rotation)), abs(math.sin(lenses.rotation))
    if c * c - s * s > _SMALL_ANGLE:  # the largest upright rectangle in a sensor that is seen rotated
        across, down = (width * c - height * s) / (c * c - s * s), (height * c - width * s) / (c * c - s * s)
    else:  # the largest one of the sensor's own shape
        share = min(width / (width * c + height * s), height / (width * s + height * c))
        across, down = share * width, share * height
    pixel = lenses.row_distance
    half_rows = math.floor(down / 2 / pixel - 0.5)
    columns = math.floor(across / pixel) + 1
    if min(2 * half_rows + 1, columns) < LEAST_SIZE:
        raise LightFieldError(
            f"{name} has too few microlenses, {max(columns, 0)} x {max(2 * half_rows + 1, 0)}: "
            f"its views would have fewer than {LEAST_SIZE} pixels along a side."
        )
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    grid = _centred(lenses, middle, half_rows, columns)
    while lenses.slant.any() and min(half_rows, columns // 2) > 1 and not _inside(grid, shape, reach):
        half_rows, columns = half_rows - 1, columns - max(1, round(columns / (2 * half_rows + 1))) * 2
        grid = _centred(lenses, middle, half_rows, columns)
    return grid


def _centred(lenses: Microlenses, middle: NDArray[np.float64], half_rows: int, columns: int) -> ViewGrid:
    """Return the grid of so many rows and columns around a point of the sensor."""
    pixel, axes = lenses.row_distance, lenses.axes
    middle_row = round(float((middle - lenses.origin) @ axes[1]) / pixel)
    off_row = float((middle - lenses.origin) @ axes[1]) - middle_row * pixel
    origin = middle - off_row * axes[1] - half_rows * pixel * axes[1] - (columns - 1) / 2 * pixel * axes[0]
    return ViewGrid(lenses, origin, (2 * half_rows + 1, columns), middle_row - half_rows)


def _inside(grid: ViewGrid, shape: tuple[int, ...], reach: float) -> bool:
    """Tell whether the corners of the grid lie at least `reach` pixels inside a sensor [y, x]."""
    height, width = grid.shape
    rows, columns = (np.array(a, np.float64) for a in ([0, 0, height - 1, height - 1], [0, width - 1, 0, width - 1]))
    lenses = grid.lenses
    along = (grid.origin - lenses.origin) @ lenses.axes[0] + columns * grid.pixel
    k = (along - (rows + grid.first_row) * float(lenses.down @ lenses.axes[0])) / lenses.pitch
    x, y = lenses.centres(k, rows + grid.first_row).T
    return bool(min(x.min(), y.min(), shape[1] - 1 - x.max(), shape[0] - 1 - y.max()) >= reach)


def sample_views(
    image: Float32Array, grid: ViewGrid, positions: NDArray[np.float64], step: float
) -> NDArray[np.float32]:
    """Sample views, float32 [n, y, x, c], from a sensor image [c, y, x] with every colour at every pixel.

    Positions [n, 2] are (du, dv) of each view from the middle of the microlenses, du along the rows, in view steps of
    `step` pixels. Interpolation is linear within a lens, and cubic along the rows of lenses.
    """
    lenses = grid.lenses
    height, width = grid.shape
    rows = np.arange(height, dtype=np.float64) + grid.first_row
    # Where along its row of lenses each pixel lies, in lenses.
    shift = (grid.origin - lenses.origin) @ lenses.axes[0]
    slide = float(lenses.down @ lenses.axes[0])
    k = (shift + np.arange(width) * grid.pixel - rows[:, None] * slide) / lenses.pitch
    first = np.floor(k[:, :1]).astype(np.int64) - 1
    count = int((np.floor(k[:, -1:]).astype(np.int64) - first).max()) + 3
    nodes = lenses.centres(first + np.arange(count), np.broadcast_to(rows[:, None], (height, count)))
    index = np.floor(k).astype(np.int64) - 1 - first + np.arange(height)[:, None] * count
    weights = _cubic(k - np.floor(k))
    views = np.empty((len(positions), height, width, len(image)), np.float32)
    for view, offset in zip(views, positions @ lenses.axes * step, strict=True):
        start, x, y = _between(nodes + offset, image.shape[1:])
        for channel, plane in enumerate(image):
            samples = _linear(plane, start, x, y)
            view[..., channel] = sum(weights[tap] * samples.take(index + tap) for tap in range(_TAPS))
    return views


def _between(
    points: NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], Float32Array, Float32Array]:
    """Return the pixel above and to the left of points (x, y), its place in memory, and how far beyond they are."""
    x, y = np.clip(points[..., 0], 0, shape[1] - 1), np.clip(points[..., 1], 0, shape[0] - 1)
    left, top = np.minimum(x.astype(np.int64), shape[1] - 2), np.minimum(y.astype(np.int64), shape[0] - 2)
    return top * shape[1] + left, (x - left).astype(np.float32), (y - top).astype(np.float32)


def _linear(plane: Float32Array, start: NDArray[np.int64], x: Float32Array, y: Float32Array) -> Float32Array:
    """Interpolate a plane [y, x] linearly between the pixels that `_between` found."""
    upper, lower = (plane.take(start + row) * (1 - x) + plane.take(start + row + 1) * x for row in (0, plane.shape[1]))
    return np.asarray(upper * (1 - y) + lower * y)


def _cubic(t: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return [4, ...], the weights of the nodes at -1, 0, 1, 2 for a value at t in [0, 1): Keys 1981 with a = -1/2."""
    return np.stack(
        [
            ((2 - t) * t - 1) * t / 2,
            ((3 * t - 5) * t * t + 2) / 2,
            ((4 - 3 * t) * t + 1) * t / 2,
            (t - 1) * t * t / 2,
        ]
    ).astype(np.float32)
