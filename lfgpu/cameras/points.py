"""Points of the reference view that tell about cameras: with texture, on smooth surfaces, seen by the views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras.surface import grey
from lfgpu.contract import Device, Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import eroded, gradient_size, smoothed, window_max, window_min

_TOLERANCE = 1.2  # pixels in the farthest view: a surface that is nearer by less hides nothing
_TILES = 12  # along the longer side: points are spread over them, and errors within one belong together
_TILE = np.uint64(56)  # bits below the number of the tile in a key by which points are sorted
_LEAST_GRADIENT = 0.01  # intensity per pixel: less is no texture
_EDGE = 1.0  # pixels in the farthest view: where disparities around a point differ by more, it is left out
_LEAST_STEP, _PLACES = 2, 128  # pixels between windows, at least; windows along the longer side, at most
_WINDOW = 6  # pixels: side of a window
_BLOCK = 16  # pixels: side of the blocks in which nearer surfaces are looked for first
_AT_ONCE = 16  # views whose visibility is computed together


@dataclass(frozen=True, eq=False)
class Points:
    """Points of the reference view that have texture and lie on smooth surfaces."""

    x: Float64Array  # float64 [p], columns in pixels
    y: Float64Array  # float64 [p], rows in pixels
    disparity: Float64Array  # float64 [p], pixels per view step
    visible: NDArray[np.float32]  # float32 [n, p], 1 where a view sees the point, else 0
    tile: NDArray[np.intp]  # int [p], the part of the picture that each point lies in

    def some(self, chosen: NDArray[np.bool_]) -> Points:
        """Select points by a mask [p]."""
        return Points(
            self.x[chosen], self.y[chosen], self.disparity[chosen], self.visible[:, chosen], self.tile[chosen]
        )


def farthest(lf: LightField) -> float:
    """Measure the distance of the farthest camera from the reference, view steps."""
    return float(np.hypot(*lf.offsets.T).max())


def known_pixels(lf: LightField, disparity: NDArray[np.floating], rows: slice = slice(None)) -> NDArray[np.bool_]:
    """Find the pixels [y, x] of the reference, or of some rows, that are valid and have a disparity."""
    known = np.isfinite(disparity[rows])
    return known if lf.valid is None else known & lf.valid[lf.reference_index][rows]


def choose_points(lf: LightField, disparity: NDArray[np.floating], device: Device, *, most: int) -> Points:
    """Choose up to `most` points: those of the strongest gradients in each part of the reference view.

    `disparity` [y, x] is the map of the reference view; NaN where it is unknown, and no point is chosen there.
    """
    map_, y, x, tile = on_surfaces(lf, disparity, most)
    seen = visible(map_, lf.offsets, y, x, device, tolerance=_TOLERANCE / farthest(lf)).astype(np.float32)
    return Points(x.astype(np.float64), y.astype(np.float64), map_[y, x].astype(np.float64), seen, tile)


def visible(
    map_: NDArray[np.float32],
    offsets: NDArray[np.floating],
    y: NDArray[np.intp],
    x: NDArray[np.intp],
    device: Device,
    *,
    tolerance: float,
) -> NDArray[np.bool_]:
    """Tell which views, at `offsets` [n, 2], see pixels of a map, in rows `y` and columns `x` of any shape: [n, ..].

    A pixel is hidden by what is nearer by more than `tolerance`, pixels per view step, and lands on the same pixel.
    """
    height, width = map_.shape
    field, d, seen = device.field(map_), map_[y, x], []
    nearest, find = device.zeros((_AT_ONCE, height, width)), device.kernels.z_buffer(map_.shape, device.name, reach=0)
    for first in range(0, len(offsets), _AT_ONCE):
        some = offsets[first : first + _AT_ONCE].astype(np.float32)
        find(field, device.field(some), nearest, reach=0)
        for (du, dv), surface in zip(some, device.kernels.numpy(nearest), strict=False):
            across, down = x - d * du, y - d * dv
            inside = (across >= 0) & (across <= width - 1) & (down >= 0) & (down <= height - 1)
            row, column = (np.floor(np.where(inside, place, 0) + 0.5).astype(np.intp) for place in (down, across))
            seen.append(inside & (d >= surface[row, column] - tolerance))
    return np.array(seen)


def on_surfaces(
    lf: LightField, disparity: NDArray[np.floating], most: int
) -> tuple[NDArray[np.float32], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Choose points off the depth edges: the map with unknown pixels at its far end, rows, columns, tiles."""
    known = known_pixels(lf, disparity)
    far = float(np.nanmin(disparity)) if known.any() else 0.0
    map_ = np.where(known, disparity, far).astype(np.float32)
    smooth = window_max(map_, 5) - window_min(map_, 5) <= _EDGE / farthest(lf)
    return map_, *textured(smoothed(grey(lf, lf.reference_index), 0.7), eroded(known, 3) & smooth, most)


class Windows:
    """Windows of 6 x 6 pixels of the reference view, at most about `_PLACES` along each side, by their texture."""

    def __init__(self, lf: LightField) -> None:
        self.lf = lf
        self._step = max(_LEAST_STEP, -(-max(lf.size) // _PLACES))

    def rank(self) -> None:
        """Order the windows by texture now: it is done once, and needs no map."""
        _ = self._ranked

    @cached_property
    def _ranked(self) -> _Ranked:
        lf, rows = self.lf, self._rows
        view = lf.views[lf.reference_index]

        def pair(first: int) -> NDArray[np.float32]:
            """Add two rows of each window, and their colours."""
            sums = np.add(*rows(view, first, first + 1), dtype=np.uint16 if view.dtype == np.uint8 else np.float32)
            return reduce(np.add, np.moveaxis(sums, -1, 0)).astype(np.float32, copy=False)

        upper, lower = pair(1), pair(3)
        left, near_left, near_right, right = rows((upper + lower).T, 1, 2, 3, 4)
        across, down = right + near_right - near_left - left, reduce(np.add, rows((lower - upper).T, 1, 2, 3, 4))
        return _ranked(np.hypot(across, down).T * np.float32(lf.scale / (16 * lf.channels)))

    def on_surfaces(
        self, disparity: NDArray[np.floating], most: int
    ) -> tuple[NDArray[np.float32], NDArray[np.intp], NDArray[np.intp]]:
        """Choose points amid windows on smooth surfaces: the map, NaN where it is unknown, rows, columns."""
        lf, rows, whole = self.lf, self._rows, range(_WINDOW)
        map_ = disparity.astype(np.float32, copy=False)
        if lf.valid is not None:
            map_ = np.where(lf.valid[lf.reference_index], map_, np.float32(np.nan))
        nearest, least = (
            reduce(end, rows(reduce(end, rows(map_, *whole)).T, *whole)).T for end in (np.maximum, np.minimum)
        )
        y, x, _ = self._ranked.some(nearest - least <= _EDGE / farthest(lf)).strongest(most)
        return map_, self._step * y + _WINDOW // 2 - 1, self._step * x + _WINDOW // 2 - 1

    def _rows(self, values: NDArray[Any], *places: int) -> list[NDArray[Any]]:
        """Take those rows of each window."""
        return [values[k :: self._step][: max(0, (len(values) - _WINDOW) // self._step + 1)] for k in places]


def textured(
    image: NDArray[np.float32], usable: NDArray[np.bool_], most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Choose up to `most` usable pixels [y, x] of an image where it has texture: rows, columns, tiles."""
    return _ranked(gradient_size(image), usable).strongest(most, every=3)  # neighbours tell the same


def _ranked(strength: NDArray[np.float32], usable: NDArray[np.bool_] | None = None) -> _Ranked:
    """Order the pixels [y, x] by the strength of their gradients, the strongest of each tile first."""
    side, is_textured = max(strength.shape) / _TILES, strength >= _LEAST_GRADIENT
    rows, columns = np.nonzero(is_textured if usable is None else usable & is_textured)
    row, column = ((np.arange(size) / side).astype(np.uint64) for size in strength.shape)
    tiles = row[rows] * np.uint64(_TILES) + column[columns]
    # By tile, and the strongest first: positive numbers are in the order of their bits. The last bits are the place.
    room = np.uint64(max(25, len(rows).bit_length()))
    weakness = np.uint64(2**31 - 1) - strength[rows, columns].view(np.uint32) >> room - np.uint64(25)
    keys = np.sort(tiles << _TILE | weakness << room | np.arange(len(rows), dtype=np.uint64))
    return _Ranked(keys, (np.uint64(1) << room) - np.uint64(1), rows, columns)


@dataclass(frozen=True, eq=False)
class _Ranked:
    """Pixels with texture in order: a key has the tile in its first bits, and which of the pixels it is in its last."""

    keys: NDArray[np.uint64]
    last: np.uint64  # these bits
    rows: NDArray[np.intp]  # of the pixels, as the columns, in any order
    columns: NDArray[np.intp]

    def some(self, usable: NDArray[np.bool_]) -> _Ranked:
        """Select pixels by a mask [y, x]."""
        return replace(self, keys=self.keys[usable[self.rows, self.columns][self._order(self.keys)]])

    def strongest(self, most: int, *, every: int = 1) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Choose up to `most`, of the strongest of each tile one in `every`; returns their rows, columns and tiles."""
        keys = self.keys
        if len(keys) > most:
            starts = np.searchsorted(keys, np.arange(_TILES**2 + 1, dtype=np.uint64) << _TILE)
            counts = np.diff(starts)
            rank = every * np.arange(max(1, most // int(np.count_nonzero(counts))))
            keys = keys[(starts[:-1, None] + rank)[rank < counts[:, None]]]
        order = self._order(keys)
        return self.rows[order], self.columns[order], (keys >> _TILE).astype(np.intp)

    def _order(self, keys: NDArray[np.uint64]) -> NDArray[np.intp]:
        return (keys & self.last).astype(np.intp)


def hidden(
    lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp], index: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Find the points [p] of the reference that a nearer surface of its map covers in views [n], on the host: [n, p].

    A surface that is nearer by k pixels in that view lies k pixels beside the point in the reference, along the offset.
    """
    (height, width), least = lf.size, _TOLERANCE / farthest(lf)
    covered = np.zeros((len(index), len(x)), np.bool_)
    d = map_[y, x].astype(np.float64)
    distance, nearest = np.maximum(np.hypot(*lf.offsets[index].T), 1e-9), float(np.nanmax(map_))
    reach = int(np.ceil((nearest - float(d.min())) * distance.max())) + 1
    behind = np.flatnonzero(_nearest_around(map_, reach)[y // _BLOCK, x // _BLOCK] - d >= least)
    if not len(behind):
        return covered
    disparity, down, across = (values[behind].astype(np.float32) for values in (d, y, x))
    # The places beside each point, one after the other by view.
    count = 1 + ((nearest - float(disparity.min())) * distance).astype(np.intp)
    first, view = np.cumsum(count) - count, np.repeat(np.arange(len(index)), count)
    far = distance[view]
    steps = (1 + np.arange(len(view)) - first[view]) / far
    right, below = (steps * lf.offsets[index][view].T).astype(np.float32)[..., None]
    rows, columns = np.rint(down + below).astype(np.int32), np.rint(across + right).astype(np.int32)
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    nearer = map_.take(rows * width + columns, mode="clip") - disparity
    low, high = np.maximum(steps - 0.7 / far, least), steps + 0.7 / far
    found = inside & (nearer >= low[:, None]) & (nearer <= high[:, None])
    covered[:, behind] = np.logical_or.reduceat(found, first)
    return covered


def _nearest_around(map_: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Find the largest disparity around each block of a map, at least as far as `reach` pixels: one for each block."""
    rows = [np.fmax.reduce(map_[first : first + _BLOCK]) for first in range(0, map_.shape[0], _BLOCK)]
    largest = np.fmax.reduceat(rows, np.arange(0, map_.shape[1], _BLOCK), axis=1)
    return window_max(np.fmax(largest, np.float32(-np.inf)), 2 * (reach // _BLOCK + 1) + 1)
