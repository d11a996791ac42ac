"""Views between their pixels: a smooth look-up with derivatives, patches by bilinear look-up, and a sweep over them."""

import math
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import mean_of_channels

_REACH = 2  # pixels from the middle of a patch to its border
_BEYOND = 3  # pixels by which the look-up continues a picture beyond its border


def grey(lf: LightField, index: int) -> NDArray[np.float32]:
    """Average the colours of a view: float32 [y, x] in [0, 1]."""
    return _grey(lf.views[index], lf.scale)


def grey_at(lf: LightField, index: int, pixels: NDArray[np.integer]) -> NDArray[np.float32]:
    """Average the colours of some pixels of a view, given by their places row by row: float32 [p] in [0, 1]."""
    return _grey(lf.views[index].reshape(-1, lf.channels).take(pixels, axis=0), lf.scale)


class Surface:
    """Cubic B-spline surface over a picture [y, x, c], with the pixels as coefficients.

    The spline smooths by 0.58 px. An interpolating spline would not do: its noise is weaker halfway between pixels than
    on them, so the sum of squares is least where views are looked up halfway, and noisy views drift there by up to 0.1
    px. Smoothed noise is nearly as strong everywhere. `scale` multiplies stored values.
    """

    def __init__(self, picture: NDArray[Any], scale: float = 1.0) -> None:
        self._picture, self._scale, self._size = picture, scale, picture.shape[:2]
        size = self._size
        mode = "reflect" if min(size) > _BEYOND else "edge"
        self._rows, self._columns = (np.pad(np.arange(side), _BEYOND, mode=mode) for side in size)  # type: ignore[call-overload]

    def __call__(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Look up the mean of the colours: value and derivatives by x and y at places [p], moved into the frame."""
        height, width = self._size
        x0, wx, sx = _spline_weights(np.clip(x, 0, width - 1))
        y0, wy, sy = _spline_weights(np.clip(y, 0, height - 1))
        taps = np.arange(_BEYOND - 1, _BEYOND + 3)[:, None]
        rows, columns = self._rows[y0 + taps], self._columns[x0 + taps]
        shown = _grey(_pixels(self._picture, rows[:, None], columns[None]), self._scale)
        value, by_x, by_y = (np.zeros(len(x)) for _ in range(3))
        for j in range(4):
            row, slope = np.zeros(len(x)), np.zeros(len(x))
            for i in range(4):
                row += shown[j, i] * wx[i]
                slope += shown[j, i] * sx[i]
            value += row * wy[j]
            by_x += slope * wy[j]
            by_y += row * sy[j]
        return value, by_x, by_y


def looked_up(lf: LightField, index: NDArray[np.intp], y: Float64Array, x: Float64Array) -> NDArray[np.float32]:
    """Look up the mean of the colours of views [n] at places [n, p] as `Surface` does, off their outermost pixels."""
    row, column = y.astype(np.intp), x.astype(np.intp)
    taps = _grey(blocks(lf.views, index, row, column), lf.scale)
    down, across = (_weights((at - whole).astype(np.float32)) for at, whole in ((y, row), (x, column)))
    rows = sum(taps[..., i] * across[i] for i in range(4))
    return np.asarray(sum(rows[j] * down[j] for j in range(4)))


def with_slopes(
    lf: LightField, row: NDArray[np.intp], column: NDArray[np.intp]
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Look up pixels [p] of the reference view as `Surface` does, off its outermost ones: value, slopes by x and y."""
    taps = _grey(blocks(lf.views, np.array([lf.reference_index]), row[None], column[None]), lf.scale)[:3, 0, :, :3]
    mean, slope = (1 / 6, 2 / 3, 1 / 6), (-1 / 2, 0.0, 1 / 2)  # of whole pixels
    value, by_x, by_y = (
        np.einsum("jpi,j,i->p", taps, down, across) for down, across in ((mean, mean), (mean, slope), (slope, mean))
    )
    return value, by_x, by_y


def blocks(
    values: NDArray[Any], index: NDArray[np.intp], row: NDArray[np.intp], column: NDArray[np.intp]
) -> NDArray[Any]:
    """Cut 4 x 4 pixels out of views [.., y, x, c]: [4, n, p, 4, c], the second of each axis at the places [n, p]."""
    *shape, width, channels = values.shape
    view, rows, first = index[:, None], row + np.arange(-1, 3)[:, None, None], column - 1
    if values.strides[2:] != (channels * values.itemsize, values.itemsize):
        return np.asarray(values[view[..., None], rows[..., None], first[..., None] + np.arange(4)])
    # Four pixels side by side are taken as one item, twice as fast.
    runs = as_strided(values, (*shape, width - 3, 4 * channels), values.strides, writeable=False)
    taken = runs.view(f"V{4 * channels * values.itemsize}")[..., 0][view, rows, first]
    return taken.view(values.dtype).reshape(*taken.shape, 4, channels)


def patches(
    picture: NDArray[np.float32], x: NDArray[np.intp], y: NDArray[np.intp], right: float = 0.0, down: float = 0.0
) -> NDArray[np.float32]:
    """Cut out the 5 x 5 pixels [p, 25] around points moved by (right, down): bilinear, the border continued."""
    height, width = picture.shape
    column, row = math.floor(right), math.floor(down)
    across, along = np.float32(right - column), np.float32(down - row)
    reach = np.arange(-_REACH, _REACH + 2)
    rows = (y[:, None] + (row + reach)).clip(0, height - 1)
    columns = (x[:, None] + (column + reach)).clip(0, width - 1)
    found = picture[rows[:, :, None], columns[:, None, :]]
    found = (1 - along) * found[:, :-1] + along * found[:, 1:]
    found = (1 - across) * found[:, :, :-1] + across * found[:, :, 1:]
    return found.reshape(len(x), -1)


def _pixels(picture: NDArray[Any], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    """Read pixels of a picture [y, x, c]; of one whose pixels lie in a row that is four times as fast."""
    if not picture.flags.c_contiguous:
        return np.asarray(picture[rows, columns])
    return picture.reshape(-1, picture.shape[2]).take(rows * picture.shape[1] + columns, axis=0)


def _grey(picture: NDArray[Any], scale: float) -> NDArray[np.float32]:
    return mean_of_channels(picture, np.float32) * np.float32(scale)


def _spline_weights(at: Float64Array) -> tuple[NDArray[np.intp], list[Float64Array], list[Float64Array]]:
    """First of the four taps less one, their weights in the cubic B-spline, and the slopes of these."""
    whole = np.floor(at).astype(np.intp)
    t = at - whole
    s = 1 - t
    return whole, _weights(t), [-s * s / 2, t * (1.5 * t - 2), s * (2 - 1.5 * s), t * t / 2]


def _weights(t: NDArray[Any]) -> list[NDArray[Any]]:
    """Weights in the cubic B-spline of the four taps around a place that lies `t` past the second one."""
    s = 1 - t
    return [s * s * s / 6, 2 / 3 - t * t * (1 - t / 2), 2 / 3 - s * s * (1 - s / 2), t * t * t / 6]


LABELS = 65
"""Number of disparities that are tried."""


def sweep(
    patch: NDArray[np.float32],
    pictures: list[NDArray[np.float32]],
    offsets: Float64Array,
    x: NDArray[np.intp],
    y: NDArray[np.intp],
    labels: Float64Array,
    *,
    moved: Float64Array | None = None,
) -> tuple[Float64Array, Float64Array]:
    """Find the least cost [p] of each point, and its disparity.

    The cost is the mean absolute difference of patches without their mean and contrast, in the better three quarters of
    the pictures. `patch` [p, 25] is cut from the reference, `offsets` [n, 2] are those of the pictures, which are each
    `moved` [n, 2] by so many pixels to the right and down; None: not at all.
    """
    moved = np.zeros_like(offsets) if moved is None else moved
    best, chosen = np.full(len(patch), np.inf), np.zeros(len(patch))
    plain = _plain(patch)
    for d in labels:
        costs = [
            np.abs(_plain(patches(picture, x, y, right - d * du, down - d * dv)) - plain)
            for picture, (du, dv), (right, down) in zip(pictures, offsets, moved, strict=True)
        ]
        better = np.sort(np.stack(costs).mean(2), axis=0)[: (3 * len(pictures) + 3) // 4]
        cost = better.mean(0)
        chosen = np.where(cost < best, d, chosen)
        best = np.minimum(best, cost)
    return best, chosen


def _plain(patch: NDArray[np.floating]) -> Float64Array:
    """Patches [p, k] without their mean and contrast."""
    centred = patch - patch.mean(1, keepdims=True)
    return np.asarray(centred / (np.abs(centred).mean(1, keepdims=True) + np.float32(3e-3)))
