"""Vignetting of microlenses: the share of the light that each pixel gets, from a white image or from the capture
itself.
"""

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from lfgpu.io.lenslet.lattice import Microlenses

Float32Array: TypeAlias = NDArray[np.float32]

BRIGHTEST = 0.98  # of the white level: what is brighter may be cut off, and tells nothing

_BINS = 4  # for each pixel, in the mean microlens image
_ROWS = 256  # of pixels that are worked on at a time, for memory
_STRIP = 8  # rows of lenses that are looked at together for the mean microlens image
_ENOUGH = 3_000_000  # pixels that tell it; of larger sensors strips are left out
_ROUNDS = 4
_SMOOTHING = 1.0  # bins
_BLOCK = 12  # pixels of a view whose means are compared with those of the middle view
_MOST_GAIN = 2.0
_TRIMMED = 3.0  # residuals beyond so many median ones do not count
_WHITE_PERCENTILE = 99.0


def bands(height: int) -> Iterator[slice]:
    """Return slices of rows that together are the whole height."""
    for top in range(0, height, _ROWS):
        yield slice(top, min(top + _ROWS, height))


def offsets(grid: Microlenses, rows: slice, width: int) -> tuple[NDArray[np.int32], NDArray[np.int32], Float32Array]:
    """Return (k, row) of the lens of each pixel of some rows, and its offset [2, y, x] from the centre along `axes`."""
    x, y = np.arange(width, dtype=np.float32), np.arange(rows.start, rows.stop, dtype=np.float32)
    k, row = grid.nearest(x, y)
    origin, along, down = (step.astype(np.float32) for step in (grid.origin, grid.along, grid.down))
    denser = 1 + k * np.float32(grid.slant[0]) + row * np.float32(grid.slant[1]) if grid.slant.any() else np.float32(1)
    dx = x - origin[0] - (k * along[0] + row * down[0]) / denser
    dy = (y - origin[1])[:, None] - (k * along[1] + row * down[1]) / denser
    axes = grid.axes.astype(np.float32)
    return k, row, np.stack([axes[0, 0] * dx + axes[0, 1] * dy, axes[1, 0] * dx + axes[1, 1] * dy])


def from_white_image(white: Float32Array, colours: NDArray[np.int64]) -> Float32Array:
    """Compute [y, x] in [0, 1] from a white image [y, x] of the same mosaic: each colour's white becomes 1.

    `colours` [2, 2] is the colour of each place of the mosaic (see `bayer.COLOURS`).
    """
    gain = np.empty_like(white)
    for colour in np.unique(colours):
        places = [(i, j) for i in (0, 1) for j in (0, 1) if colours[i, j] == colour]
        level = np.percentile(np.concatenate([white[i::2, j::2].ravel() for i, j in places]), _WHITE_PERCENTILE)
        for i, j in places:
            gain[i::2, j::2] = white[i::2, j::2] / max(float(level), 1e-6)
    return np.clip(gain, 0.0, 1.0)


def field_gains(views: Float32Array, middle: int) -> Float32Array:
    """Return gains [n, y, x] that make each view, linear and 1 where cut off, as bright as the middle one.

    Microlenses far from the middle of the sensor see the main lens from the side, so that one and the same mean
    microlens is not quite right for them. What is missing varies slowly over the field: a polynomial of degree 4 fitted
    to the logarithm of the ratio of block means, by trimmed least squares, as blocks with parallax or gloss differ
    otherwise. All colours have the same gain.
    """
    count, height, width, _ = views.shape
    block = min(_BLOCK, height // 6, width // 6)
    rows, columns = height // max(block, 1), width // max(block, 1)
    gains = np.ones((count, height, width), np.float32)
    if block < 1:
        return gains
    cut = views[:, : rows * block, : columns * block].reshape(count, rows, block, columns, block, -1)
    means = cut.mean((2, 4, 5)).reshape(count, -1)
    whole = (cut.max((2, 4, 5)) < BRIGHTEST).reshape(count, -1)
    middles = [(np.arange(n) + 0.5) * block - 0.5 for n in (rows, columns)]
    at_blocks = _powers(middles[0] * 2 / height - 1, middles[1] * 2 / width - 1).reshape(-1, rows * columns).T
    at_pixels = _powers(np.arange(height) * 2 / height - 1, np.arange(width) * 2 / width - 1)
    for view in range(count):
        used = whole[view] & whole[middle] & (np.minimum(means[view], means[middle]) > 0.02 * means[middle].mean())
        if view == middle or used.sum() < 4 * at_blocks.shape[1]:
            continue
        ratio = np.log(means[middle, used] / means[view, used])
        design, root = at_blocks[used], np.sqrt(np.minimum(means[view, used], means[middle, used]))
        kept = np.ones(len(ratio), np.bool_)
        for _ in range(3):
            weight = root * kept
            fit = np.linalg.lstsq(design * weight[:, None], ratio * weight, rcond=None)[0]
            off = np.abs(ratio - design @ fit)
            kept = off <= _TRIMMED * np.median(off) + 1e-6
        limit = np.log(_MOST_GAIN)
        gains[view] = np.exp(np.clip(np.tensordot(fit, at_pixels, 1), -limit, limit))
    return gains


def _powers(y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute all products x^i y^j with i + j <= 4, [15, y, x]."""
    return np.array([y[:, None] ** j * x**i for j in range(5) for i in range(5 - j)])


def _strips(shape: tuple[int, ...], grid: Microlenses) -> Iterator[slice]:
    """Return slices of rows, spread over a sensor [y, x], that have about `_ENOUGH` pixels, or all there are."""
    height = round(_STRIP * grid.row_distance)
    step = max(1, round(shape[0] * shape[1] / _ENOUGH))
    for top in range(0, shape[0], step * height):
        yield slice(top, min(top + height, shape[0]))


class MeanMicrolens:
    """The mean image of a microlens in a capture, over its lenses: what the scene shows averages out.

    The level of a lens and the mean image are found in turn, each by least squares from the other, in each colour of
    the mosaic by itself. Pixels that are cut off at the white level have no part in it.
    """

    def __init__(self, mosaic: Float32Array, grid: Microlenses, colours: NDArray[np.int64]) -> None:
        reach = grid.pitch * (0.75 if grid.square else 0.6) + 1  # a bit beyond the corners
        self._half = int(np.ceil(reach * _BINS))
        self.table = self._estimate(mosaic, grid, colours)
        """float32 [across, along], in [0, 1], 1 where it is brightest; the middle bin is the lens's centre."""

    def at(self, offset: Float32Array) -> Float32Array:
        """Return the brightness at offsets [2, ...] (along, across) from the lens's centre, in pixels."""
        from scipy import ndimage  # not for those who read something else

        return np.asarray(
            ndimage.map_coordinates(
                self.table, (offset[::-1] * _BINS + self._half).astype(np.float32), order=1, mode="nearest"
            ),
            np.float32,
        )

    def over(self, grid: Microlenses, shape: tuple[int, ...]) -> Float32Array:
        """Return the brightness at every pixel of a sensor [y, x]."""
        values = np.empty(shape, np.float32)
        for rows in bands(shape[0]):
            values[rows] = self.at(offsets(grid, rows, shape[1])[2])
        return values

    def _estimate(self, mosaic: Float32Array, grid: Microlenses, colours: NDArray[np.int64]) -> Float32Array:
        from scipy import ndimage

        side = 2 * self._half + 1
        lenses, bins, values = [], [], []
        for rows in _strips(mosaic.shape, grid):
            k, row, offset = offsets(grid, rows, mosaic.shape[1])
            colour = colours[np.arange(rows.start, rows.stop)[:, None] % 2, np.arange(mosaic.shape[1]) % 2]
            used = mosaic[rows] < BRIGHTEST
            place = np.clip(np.rint(offset[:, used] * _BINS).astype(np.int32) + self._half, 0, side - 1)
            bins.append(place[1] * side + place[0])
            # A number for each colour of each lens; k and row stay within a few thousand of zero.
            lenses.append(((row[used] + 8192) * 16384 + k[used] + 8192).astype(np.int64) * 4 + colour[used])
            values.append(mosaic[rows][used])
        _, lens = np.unique(np.concatenate(lenses), return_inverse=True)
        place, value = np.concatenate(bins), np.concatenate(values)
        mean = np.ones(side * side)
        for _ in range(_ROUNDS):
            weight = mean[place]
            level = np.bincount(lens, value * weight) / np.maximum(np.bincount(lens, weight * weight), 1e-9)
            light = level[lens]
            sums = [
                np.bincount(place, light * other, minlength=side * side).reshape(side, side) for other in (value, light)
            ]
            above, below = (ndimage.gaussian_filter(total, _SMOOTHING) for total in sums)
            mean = (above / np.maximum(below, 1e-9 * below.max())).ravel()
            mean /= mean.max()
        return mean.reshape(side, side).astype(np.float32)
