"""Screening of the cameras: a test at some hundred points that says whether a look at them can find anything.

Nearly all light fields are right, and a look takes longer than a fast map. The screening compares all views with the
reference, and reads only the pixels around its points. One linear step tells how each view would have to move, turn,
grow and change in brightness. Half of a finding makes the cameras worth a look, and so does noise of that size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras import consensus, findings
from lfgpu.cameras.bundle import spread, spreads
from lfgpu.cameras.points import Windows, hidden
from lfgpu.cameras.signs import order_of_depth
from lfgpu.cameras.surface import blocks, looked_up, with_slopes
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField

_SHARE = 0.5  # of a finding
_FIRST, _SURELY_RIGHT = 4, 0.75  # one in so many points ends it, if by them alone cameras have so little of that share
_IN_ALL, _LEAST, _MOST = 32_000, 400, 800  # points in all views, and bounds of those in each
_FEWEST = 150  # points: from fewer nothing is said
_AGREE = 0.2  # pixels: views that differ from the reference by no more than this in the median have the right axes
_ROUNDS, _TREND_ROUNDS = 4, 8  # of robust weights: of points, of views
_SIDES = 4  # views, those farthest away, in which the order of depth is compared
_TOLD = 50  # pixels that tell the order of depth; from fewer nobody can tell
_BAND, _BETTER = 12, 0.5  # rows in the middle, or twice as many, that end it if the map's order leaves so much less
_AS_GOOD = 0.7  # of the loss: right cameras leave at most half of what the other order of depth leaves


def worth_a_look(
    lf: LightField,
    disparity: NDArray[np.float32],
    seen: Sequence[int] | NDArray[np.intp] | None = None,
    windows: Windows | None = None,
) -> bool:
    """Tell whether something may be wrong with the cameras of the views `seen`, by default all.

    `disparity` is the map of the reference view [y, x]. Its `windows` may have been ranked before.
    """
    index = np.arange(len(lf.views)) if seen is None else lf.layout.chosen(seen)
    return _may_be_off(windows or Windows(lf), index, disparity) or _may_be_swapped(lf, index, disparity)


def _may_be_off(windows: Windows, index: NDArray[np.intp], disparity: NDArray[np.float32]) -> bool:
    """Tell whether views may be off, or there are too few points to say."""
    lf = windows.lf
    map_, y, x = windows.on_surfaces(disparity, min(max(_IN_ALL // len(index), _LEAST), _MOST))
    if len(x) < _FEWEST:
        return True
    first = _fault(lf, index, map_, y[::_FIRST], x[::_FIRST])  # so few of which are hidden that they are outliers
    return first > _SURELY_RIGHT and _fault(lf, index, map_, y, x, hidden(lf, map_, y, x, index)) > 1


def _fault(
    lf: LightField,
    index: NDArray[np.intp],
    map_: NDArray[np.float32],
    y: NDArray[np.intp],
    x: NDArray[np.intp],
    covered: NDArray[np.bool_] | None = None,
) -> float:
    """Measure how far views are out of line, turned, scaled or of other brightness, in units of what is worth a look.

    Noise between the views counts as well: mirrored places leave much of it. Points that are `covered` [n, p] do not.
    """
    offsets, radius = lf.offsets[index], float(np.hypot(*lf.size)) / 2
    value, inside = _shown(lf, index, map_, y, x)
    sees = (inside if covered is None else inside & ~covered).astype(np.float64)
    template, by_x, by_y = with_slopes(lf, y, x)
    parallax = offsets @ np.stack([by_x, by_y])
    middle = (np.array(lf.size[::-1]) - 1) / 2
    across, down = (x - middle[0]) / radius, (y - middle[1]) / radius
    slopes = [by_x, by_y, by_y * across - by_x * down, by_x * across + by_y * down]
    jacobian = np.stack([*slopes, template, np.ones_like(template)], axis=1)  # that of all views: it is the reference's
    products = (jacobian[:, :, None] * jacobian[:, None]).reshape(-1, 36)
    found, weight, rest = np.zeros((len(value), 6)), sees, value - template
    for _ in range(_ROUNDS):
        # An error of a point's disparity, and what all views have in common, are no fault of a view.
        moved = (weight * parallax * rest).sum(0) / np.maximum((weight * parallax**2).sum(0), 1e-12)
        change = (weight * rest).sum(0) / np.maximum(weight.sum(0), 1e-12)
        left = rest - parallax * moved - change
        normal = (weight @ products).reshape(-1, 6, 6) + 1e-6 * np.eye(6)
        found = np.linalg.solve(normal, ((weight * left) @ jacobian)[..., None])[..., 0]
        left -= found @ jacobian.T
        noise = spread(left, sees)
        weight = sees / (1 + (left / (3 * noise)) ** 2) ** 2
    slope = consensus.median(np.hypot(by_x, by_y))
    shift = found[:, :2]
    if len(offsets) < consensus.MANY:  # else it is a part of the trend
        shift = consensus.without_gauge(shift, offsets)
    level = float(np.clip(consensus.median(template), 0.02, 1.0))
    bright = found[:, 4:5] + found[:, 5:] / level
    misfit = spreads(left, sees)[:, None] / slope
    each = np.concatenate([shift, found[:, 2:4], bright, misfit], axis=1)
    trends = consensus.smooth_rest(each, offsets, _TREND_ROUNDS)
    shift, shape, bright, misfit = np.split(trends, [2, 4, 5], axis=1)  # shape: at the half diagonal, pixels
    sizes = (
        (noise, 2 * _AGREE * slope),
        (misfit.max(), consensus.UNLIKE),
        (np.linalg.norm(shift, axis=1).max(), findings.MOVED),
        (consensus.usual_rest(shift), findings.OUT_OF_LINE),
        (np.abs(shape).max(), findings.TURNED),
        (max(consensus.usual_rest(column[:, None]) for column in shape.T), findings.OUT_OF_SHAPE),
        (np.abs(bright).max(), findings.BRIGHTER),
    )
    return max(float(size / max(_SHARE * limit, 1e-12)) for size, limit in sizes)


def _shown(
    lf: LightField, index: NDArray[np.intp], map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp]
) -> tuple[Float64Array, NDArray[np.bool_]]:
    """Look up the values of views [n] at the points, smoothed, and whether these are within their frames, [n, p]."""
    (du, dv), (height, width) = lf.offsets[index].T[..., None], lf.size
    d = map_[y, x].astype(np.float64)
    at_x, at_y = x - d * du, y - d * dv
    inside = (at_x >= 1) & (at_x < width - 2) & (at_y >= 1) & (at_y < height - 2)
    at_x, at_y = at_x.clip(1, width - 2.01), at_y.clip(1, height - 2.01)
    if lf.valid is not None:
        inside &= blocks(lf.valid[..., None], index, at_y.astype(np.intp), at_x.astype(np.intp)).all(axis=(0, 3, 4))
    return looked_up(lf, index, at_y, at_x).astype(np.float64), inside


def _may_be_swapped(lf: LightField, index: NDArray[np.intp], disparity: NDArray[np.float32]) -> bool:
    """Tell whether far surfaces of the map may hide its near ones."""
    height, count = lf.size[0], _BAND
    while True:
        middle = slice(max(0, (height - count) // 2), (height + count) // 2)
        order = order_of_depth(lf, disparity, views=_SIDES, rows=middle, seen=index)
        told, near, far = order.told >= _TOLD, order.near.sum(), order.far.sum()
        if count >= height:
            return told and near > _AS_GOOD * far
        if told and near < _BETTER * far:
            return False
        count *= 2
