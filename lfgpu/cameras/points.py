"""Points of the reference view that tell about cameras: with texture, on smooth surfaces, seen by the views."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras.surface import grey
from lfgpu.contract import Device, Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import eroded, gradient_size, smoothed, window_max, window_min

_TOLERANCE = 1.2  # pixels in the farthest view: a surface that is nearer by less hides nothing
_TILES = 12  # along the longer side: points are spread over them, and errors within one belong together
_LEAST_GRADIENT = 0.01  # intensity per pixel: less is no texture
_EDGE = 1.0  # pixels in the farthest view: where disparities around a point differ by more, it is left out
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


def known_pixels(lf: LightField, disparity: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Find the pixels [y, x] of the reference that are valid and have a disparity."""
    known = np.isfinite(disparity)
    return known if lf.valid is None else known & lf.valid[lf.reference_index]


def choose_points(lf: LightField, disparity: NDArray[np.floating], device: Device, *, most: int) -> Points:
    """Choose up to `most` points: those of the strongest gradients in each part of the reference view.

    `disparity` [y, x] is the map of the reference view; NaN where it is unknown, and no point is chosen there.
    """
    map_, y, x, tile = on_surfaces(lf, disparity, most)
    visible = np.empty((len(lf.views), len(y)), np.float32)
    field = device.field(map_)
    for first in range(0, len(lf.views), _AT_ONCE):
        offsets = lf.offsets[first : first + _AT_ONCE]
        seen = device.zeros((len(offsets), *lf.size))
        device.kernels.visible(field, device.field(offsets), tolerance=_TOLERANCE / farthest(lf), visible_out=seen)
        visible[first : first + _AT_ONCE] = device.kernels.numpy(seen)[:, y, x]
    return Points(x.astype(np.float64), y.astype(np.float64), map_[y, x].astype(np.float64), visible, tile)


def on_surfaces(
    lf: LightField, disparity: NDArray[np.floating], most: int
) -> tuple[NDArray[np.float32], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Choose points off the depth edges: the map with unknown pixels at its far end, rows, columns, tiles."""
    known = known_pixels(lf, disparity)
    far = float(np.nanmin(disparity)) if known.any() else 0.0
    map_ = np.where(known, disparity, far).astype(np.float32)
    smooth = window_max(map_, 5) - window_min(map_, 5) <= _EDGE / farthest(lf)
    return map_, *textured(smoothed(grey(lf, lf.reference_index), 0.7), eroded(known, 3) & smooth, most)


def some_on_surfaces(
    lf: LightField, disparity: NDArray[np.floating], most: int
) -> tuple[NDArray[np.float32], NDArray[np.intp], NDArray[np.intp]]:
    """Choose points as `on_surfaces` does, on every other row and column only: the map, rows, columns."""
    known, image = known_pixels(lf, disparity), grey(lf, lf.reference_index)
    far = float(np.nanmin(disparity)) if known.any() else 0.0
    map_ = np.where(known, disparity, far).astype(np.float32)
    height, width = (side // 2 * 2 for side in lf.size)

    def of_four(join: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
        """Join each 2 x 2 pixels."""
        return reduce(join, (values[i:height:2, j:width:2] for i, j in np.ndindex(2, 2)))

    spread = window_max(of_four(np.maximum, map_), 3) - window_min(of_four(np.minimum, map_), 3)
    usable = eroded(of_four(np.logical_and, known), 2) & (spread <= _EDGE / farthest(lf))
    halved = np.asarray(of_four(np.add, image) / 8, np.float32)  # so that gradients are per pixel of the whole image
    y, x, _ = textured(halved, usable, most)
    return map_, 2 * y, 2 * x


def textured(
    image: NDArray[np.float32], usable: NDArray[np.bool_], most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Choose up to `most` usable pixels [y, x] of an image where it has texture: rows, columns, tiles."""
    strength = gradient_size(image)
    side = max(image.shape) / _TILES
    rows, columns = np.nonzero(usable & (strength >= _LEAST_GRADIENT))
    row, column = ((np.arange(size) / side).astype(np.uint64) for size in image.shape)
    tiles = row[rows] * np.uint64(_TILES) + column[columns]
    # By tile, and the strongest first: positive numbers are in the order of their bits. The last bits are the place.
    room = np.uint64(max(25, len(rows).bit_length()))
    weakness = np.uint64(2**31 - 1) - strength[rows, columns].view(np.uint32) >> room - np.uint64(25)
    keys = np.sort(tiles << np.uint64(56) | weakness << room | np.arange(len(rows), dtype=np.uint64))
    order = (keys & (np.uint64(1) << room) - np.uint64(1)).astype(np.intp)
    tiles = tiles[order].astype(np.intp)
    starts = np.flatnonzero(np.diff(tiles, prepend=-1))
    share = max(1, most // max(1, len(starts)))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff([*starts, len(order)]))
    # Of each part every third of the strongest three times as many: neighbours tell the same.
    kept = slice(None) if len(order) <= most else (rank < 3 * share) & (rank % 3 == 0)
    order = order[kept]
    return rows[order], columns[order], tiles[kept]


def hidden(
    lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp], index: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Find the points [p] of the reference that a nearer surface of its map covers in views [n], on the host: [n, p].

    A surface that is nearer by k pixels in that view lies k pixels beside the point in the reference, along the offset.
    """
    (height, width), least = lf.size, _TOLERANCE / farthest(lf)
    covered = np.zeros((len(index), len(x)), np.bool_)
    d = map_[y, x].astype(np.float64)
    distance, nearest = np.maximum(np.hypot(*lf.offsets[index].T), 1e-9), float(map_.max())
    reach = int(np.ceil((nearest - float(d.min())) * distance.max())) + 1
    behind = np.flatnonzero(_nearest_around(map_, reach)[y // _BLOCK, x // _BLOCK] - d >= least)
    if not len(behind):
        return covered
    d, y, x = d[behind], y[behind], x[behind]
    far = distance[:, None, None]
    steps = np.arange(1, int(np.ceil((nearest - float(d.min())) * distance.max())) + 1)[:, None] / far
    du, dv = lf.offsets[index].T[..., None, None]
    rows = np.rint(y + steps * dv).astype(np.intp).clip(-1, height) + 1
    columns = np.rint(x + steps * du).astype(np.intp).clip(-1, width) + 1
    nearer = np.pad(map_, 1, constant_values=np.nan).take(rows * (width + 2) + columns) - d
    found = (nearer >= np.maximum(steps - 0.7 / far, least)) & (nearer <= steps + 0.7 / far)
    covered[:, behind] = found.any(1)
    return covered


def _nearest_around(map_: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Find the largest disparity around each block of a map, at least as far as `reach` pixels: one for each block."""
    height, width = (-(-side // _BLOCK) for side in map_.shape)
    padded = np.pad(map_, [(0, -side % _BLOCK) for side in map_.shape], mode="edge")
    rows = padded.reshape(height, _BLOCK, -1).max(1)  # one axis after the other takes a quarter of the time
    largest = rows.reshape(height, width, _BLOCK).max(2)
    return window_max(largest, 2 * (reach // _BLOCK + 1) + 1)
