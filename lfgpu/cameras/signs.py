"""Signs of the axes: rows and columns of cameras that are counted the wrong way, found in the pictures.

Wrong signs of one axis, or rows taken for columns, leave no disparity at which all views agree: a plane sweep at points
with texture finds the way of counting with which they agree best. Wrong signs of both axes turn every disparity round,
and views agree as well as before; but then the surfaces that the map has as far hide those that it has as near.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras.points import Points, known_pixels
from lfgpu.cameras.surface import LABELS, grey, grey_at, patches, sweep
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField

Signs = Literal["v", "uv", "transposed", "turned"]
"""Fault of the axes: one has the wrong sign, both have, they are exchanged, or exchanged with one of the wrong sign."""

_WAYS: tuple[tuple[Signs | None, tuple[tuple[int, int], tuple[int, int]]], ...] = (
    (None, ((1, 0), (0, 1))),
    ("v", ((1, 0), (0, -1))),
    ("transposed", ((0, 1), (1, 0))),
    ("turned", ((0, 1), (-1, 0))),  # a quarter turn of the array
)
_WAYS_OF_LINES = tuple(way for way in _WAYS if way[0] in (None, "transposed"))  # signs only turn disparities round
_POINTS = 400
_VIEWS = 12
_PARALLAX = 6.0  # pixels by which the views that are compared move at most, about
_AGREE = 0.15  # of the contrast: where patches differ by less, the way that was told is right
_BETTER = 0.92  # of the median cost: how much better another way must be,
_SURE = 5.0  # and by how many standard errors of the mean over points
_SPREAD = 0.5  # view steps: cameras that stand closer to a line along an axis are in one line

_ONE_SIDED = 3  # views, the reference at their end, that do not tell the order of depth
_FARTHEST = 8  # views in which the order of depth is compared
_FEWEST = 100  # pixels that tell it
_HIDES_BETTER = 0.9  # of the loss: how much better the other order of depth must be,
_SURELY = 2.5  # and by how many standard errors, over parts of the picture
_GAP = 2.0  # pixels in the farthest view: a surface that is nearer by more hides those behind it
_DIFFERENT = 0.03  # intensity: colours that can be told apart
_EVERY = 8  # one in so many pixels that nothing hides says how bright a view is
_MOST = 0.1  # intensity: larger differences count as much
_PARTS = 12  # along the longer side: pixels of one part are of one outline


def wrong_signs(lf: LightField, disparity: NDArray[np.float32], points: Points) -> Signs | None:
    """Find the fault of the axes by the map of the reference view [y, x]; None if there is none, or nobody can tell."""
    known = disparity[np.isfinite(disparity)]
    found = wrong_axis(lf, points, float(np.abs(np.percentile(known, [1, 99])).max()))
    return "uv" if found is None and near_and_far_swapped(lf, disparity) else found


def wrong_axis(lf: LightField, points: Points, largest: float) -> Signs | None:
    """Find an axis with the wrong sign, or exchanged axes; None if there is none, or the pictures do not tell.

    `largest` is the largest absolute disparity, pixels per view step.
    """
    offsets = lf.offsets
    distance = np.hypot(*offsets.T)
    beside = np.flatnonzero(distance > 0)
    if len(points.x) < _POINTS // 8:
        return None
    in_line = min(np.ptp(offsets, axis=0)) < _SPREAD
    wanted = _PARALLAX / max(largest, 1e-6)
    order = beside[np.argsort(np.abs(distance[beside] - wanted), kind="stable")]
    chosen = _spread_over_angles(order, offsets)
    step = np.random.default_rng(0).permutation(len(points.x))[:_POINTS]
    x, y = points.x[step].astype(np.intp), points.y[step].astype(np.intp)
    patch = patches(grey(lf, lf.reference_index), x, y)
    pictures = [grey(lf, int(n)) for n in chosen]
    labels = np.linspace(-1.2 * largest, 1.2 * largest, LABELS)
    costs: dict[Signs | None, Float64Array] = {}
    moves: dict[Signs | None, Float64Array] = {}  # of the usual point in each picture, pixels
    for way, matrix in _WAYS if not in_line else _WAYS_OF_LINES:
        turned = offsets[chosen] @ np.array(matrix, np.float64).T
        cost, disparity = sweep(patch, pictures, turned, x, y, labels)
        if way is None and np.median(cost) < _AGREE:
            return None
        costs[way], moves[way] = cost, -np.median(disparity) * turned
    best = min(costs, key=lambda way: float(np.median(costs[way])))
    if in_line and best is not None:  # views that are out of line look like those of another line
        in_place, _ = sweep(patch, pictures, offsets[chosen], x, y, labels, moved=moves[best])
        costs[None] = np.minimum(costs[None], in_place)
    gain = costs[None] - costs[best]
    sure = gain.mean() > _SURE * gain.std() / np.sqrt(len(gain))
    return best if sure and np.median(costs[best]) < _BETTER * np.median(costs[None]) else None


def near_and_far_swapped(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Tell whether the far surfaces of the map [y, x] hide its near ones, in several places.

    A single outline that the map has wrong looks like that, too. So does all that is hidden in every other view: there
    the map has whatever disparity fits. Few views on one side of the reference therefore tell nothing.
    """
    on_both_sides = ((lf.offsets @ lf.offsets.T) < 0).any()
    if not on_both_sides and len(lf.views) <= _ONE_SIDED:
        return False
    order = order_of_depth(lf, disparity, views=_FARTHEST)
    gain = order.near - order.far
    sure = gain.sum() > _SURELY * np.sqrt((gain**2).sum())
    return bool(order.told >= _FEWEST and sure and order.far.sum() < _HIDES_BETTER * order.near.sum())


@dataclass(frozen=True, eq=False)
class Order:
    """Differences between views and the near or the far one of two surfaces that land at the same pixel.

    `near` and `far` are sums of absolute differences [t], intensity, for each part of the picture with such pixels.
    """

    told: int  # number of such pixels in all views that were compared
    near: Float64Array
    far: Float64Array


def order_of_depth(
    lf: LightField,
    disparity: NDArray[np.floating],
    *,
    views: int,
    rows: slice = slice(None),
    seen: NDArray[np.intp] | None = None,
) -> Order:
    """Compare the views that are farthest from the reference with its map [y, x], NaN where it is unknown.

    They are some of `seen`, by default of all views. Only some `rows` of the map are compared.
    """
    seen = np.arange(len(lf.views)) if seen is None else seen
    distance, (height, width) = np.hypot(*lf.offsets[seen].T), lf.size
    own = rows.indices(height)[0] * width + np.flatnonzero(known_pixels(lf, disparity, rows)).astype(np.int32)
    d = disparity.astype(np.float32, copy=False).ravel()[own]
    row, column = (at.astype(np.float32) for at in np.divmod(own, np.int32(width)))
    front, back = np.empty(height * width, np.int32), np.empty(height * width, np.int32)
    side = max(lf.size) / _PARTS
    told, near, far = 0, np.zeros(_PARTS**2), np.zeros(_PARTS**2)

    def image_at(pixels: NDArray[np.intp]) -> NDArray[np.float32]:
        return grey_at(lf, lf.reference_index, own[pixels])

    for n in seen[np.argsort(-distance, kind="stable")[:views]]:
        du, dv = lf.offsets[n].tolist()
        x, y = np.rint(column - d * du).astype(np.int32), np.rint(row - d * dv).astype(np.int32)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        if lf.valid is not None:
            inside[inside] = lf.valid[n][y[inside], x[inside]]
        landed = np.flatnonzero(inside)
        place = y[landed] * np.int32(width) + x[landed]
        front[place] = landed  # the last one stays
        front[place[front[place] != landed]] = -1
        several = front[place] < 0
        alone = _EVERY * np.flatnonzero(~several[::_EVERY])
        if not len(alone):
            continue
        # How bright the whole view is does not say what hides what.
        gain = image_at(landed[alone]).mean() / max(grey_at(lf, int(n), place[alone]).mean(), 1e-6)
        landed, place = landed[several], place[several]
        order = np.argsort(d[landed], kind="stable")  # the farthest first
        landed, place = landed[order], place[order]
        front[place], back[place[::-1]] = landed, landed[::-1]
        on_top = front[place] == landed
        landed, place = landed[on_top], place[on_top]
        apart = d[landed] - d[back[place]] > _GAP / distance.max()
        landed, place = landed[apart], place[apart]
        shown = gain * grey_at(lf, int(n), place)
        surfaces = image_at(landed), image_at(back[place])
        apart = np.abs(surfaces[0] - surfaces[1]) > _DIFFERENT
        part = ((row[landed] / side).astype(np.intp) * _PARTS + (column[landed] / side).astype(np.intp))[apart]
        told += len(part)
        for loss, surface in zip((near, far), surfaces, strict=True):
            loss += np.bincount(part, np.minimum(np.abs(shown - surface), _MOST)[apart], len(loss))
    some = near + far > 0
    return Order(told, near[some], far[some])


def _spread_over_angles(order: NDArray[np.intp], offsets: Float64Array) -> NDArray[np.intp]:
    """Choose up to `_VIEWS` of the views, in this order, from all directions."""
    angle = np.arctan2(offsets[order, 1], offsets[order, 0])
    sector = np.floor((angle + np.pi) / (2 * np.pi) * 8).astype(int) % 8
    rank = np.array([(sector[:i] == s).sum() for i, s in enumerate(sector)])
    return np.asarray(order[np.lexsort((np.arange(len(order)), rank))][:_VIEWS])
