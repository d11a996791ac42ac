"""Whether rows and columns of cameras are counted the right way: what the pictures say about it.

Wrong signs of one axis, or rows taken for columns, leave no disparity at which all views agree: a small plane sweep at
points with texture says which of the four ways lets them agree best. Wrong signs of both axes turn every disparity
round, and views agree as well as before; but then what is taken for far hides what is taken for near.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration.bundle import Points, grey
from lfgpu.calibration.hiding import order_of_depth
from lfgpu.calibration.sweep import LABELS, patches, sweep
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField

Signs = Literal["v", "uv", "transposed"]

_WAYS: dict[Signs | None, tuple[tuple[int, int], tuple[int, int]]] = {
    None: ((1, 0), (0, 1)),
    "v": ((1, 0), (0, -1)),
    "transposed": ((0, 1), (1, 0)),
}
_TURNED = ((0, 1), (-1, 0))  # transposed and one axis turned round: a quarter turn of the array
_POINTS = 400
_VIEWS = 12
_PARALLAX = 6.0  # pixels by which the views that are compared move at most, about
_AGREE = 0.15  # of the contrast: where patches differ by less, the way that was told is right
_BETTER = 0.92  # of the median cost: how much better another way must be,
_SURE = 5.0  # and by how many standard errors of the mean over points
_FARTHEST = 8  # views in which it is looked at what hides what
_FEWEST = 100  # pixels that tell it
_HIDES_BETTER = 0.9  # of the loss: how much better the other order of depth must be,
_SURELY = 2.5  # and by how many standard errors, over parts of the picture
_SPREAD = 0.5  # view steps: cameras in one line say nothing about the other axis


def wrong_axis(lf: LightField, points: Points, largest: float) -> Signs | None:
    """ "v" if one of the two axes is counted the wrong way, "transposed" if rows are taken for columns (either way
    round), None if all is well or the pictures do not tell. `largest` is the largest absolute disparity."""
    offsets = lf.offsets
    distance = np.hypot(*offsets.T)
    beside = np.flatnonzero(distance > 0)
    if min(np.ptp(offsets, axis=0)) < _SPREAD or len(points.x) < _POINTS // 8:
        return None
    wanted = _PARALLAX / max(largest, 1e-6)
    order = beside[np.argsort(np.abs(distance[beside] - wanted), kind="stable")]
    chosen = _spread_over_angles(order, offsets)
    step = np.random.default_rng(0).permutation(len(points.x))[:_POINTS]
    x, y = points.x[step].astype(np.intp), points.y[step].astype(np.intp)
    patch = patches(grey(lf, lf.reference_index), x, y)
    pictures = [grey(lf, int(n)) for n in chosen]
    labels = np.linspace(-1.2 * largest, 1.2 * largest, LABELS)
    costs: dict[Signs | None, Float64Array] = {}
    for way, matrix in (*_WAYS.items(), ("turned", _TURNED)):
        moved = offsets[chosen] @ np.array(matrix, np.float64).T
        cost, _ = sweep(patch, pictures, moved, x, y, labels)
        name: Signs | None = "transposed" if way == "turned" else way  # type: ignore[assignment]
        if name not in costs or np.median(cost) < np.median(costs[name]):
            costs[name] = cost
        if name is None and np.median(cost) < _AGREE:
            return None
    best = min(costs, key=lambda way: float(np.median(costs[way])))
    gain = costs[None] - costs[best]
    sure = gain.mean() > _SURE * gain.std() / np.sqrt(len(gain))
    return best if sure and np.median(costs[best]) < _BETTER * np.median(costs[None]) else None


def near_and_far_swapped(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Whether what the map takes for far hides what it takes for near, in several places: a single outline that the map
    has wrong looks like that, too."""
    order = order_of_depth(lf, disparity, views=_FARTHEST)
    gain = order.near - order.far
    sure = gain.sum() > _SURELY * np.sqrt((gain**2).sum())
    return bool(order.told >= _FEWEST and sure and order.far.sum() < _HIDES_BETTER * order.near.sum())


def _spread_over_angles(order: NDArray[np.intp], offsets: Float64Array) -> NDArray[np.intp]:
    """Up to `_VIEWS` of the views in this order, from all directions."""
    angle = np.arctan2(offsets[order, 1], offsets[order, 0])
    sector = np.floor((angle + np.pi) / (2 * np.pi) * 8).astype(int) % 8
    rank = np.array([(sector[:i] == s).sum() for i, s in enumerate(sector)])
    return np.asarray(order[np.lexsort((np.arange(len(order)), rank))][:_VIEWS])
