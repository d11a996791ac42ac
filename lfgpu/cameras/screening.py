"""Screening of the cameras: a test at some hundred points that says whether a look at them can find anything.

Nearly all light fields are right, and a look takes longer than a fast map. The screening compares all views with the
reference, and reads only the pixels around its points. One linear step tells how each view would have to move, turn,
grow and change in brightness. Half of a finding makes the cameras worth a look, and so does noise of that size.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras import consensus, findings
from lfgpu.cameras.points import hidden, some_on_surfaces
from lfgpu.cameras.signs import order_of_depth
from lfgpu.cameras.surface import Surface
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.threads import in_threads

_SHARE = 0.5  # of a finding
_FIRST, _SURELY_RIGHT = 4, 0.75  # one in so many points ends it, if by them alone cameras have so little of that share
_IN_ALL, _LEAST, _MOST = 32_000, 400, 800  # points in all views, and bounds of those in each
_FEWEST = 150  # points: from fewer nothing is said
_AT_ONCE = 7000  # places that are looked up together
_AGREE = 0.2  # pixels: views that differ from the reference by no more than this in the median have the right axes
_ROUNDS = 2  # of robust weights
_LEAST_NOISE = 0.003  # intensity
_SIDES = 4  # views, those farthest away, in which the order of depth is compared
_TOLD = 50  # pixels that tell the order of depth; from fewer nobody can tell
_PART, _BETTER = 12, 0.5  # one in so many rows ends it, if right cameras leave so much less there than the other order
_AS_GOOD = 0.7  # of the loss: right cameras leave at most half of what the other order of depth leaves


def worth_a_look(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Tell whether something may be wrong with the cameras, by the map of the reference view [y, x]."""
    most = min(max(_IN_ALL // len(lf.views), _LEAST), _MOST)
    map_, y, x = some_on_surfaces(lf, disparity, most)
    doubts: list[Callable[[], bool]] = [partial(_may_be_off, lf, map_, y, x), partial(_may_be_swapped, lf, disparity)]
    return len(x) < _FEWEST or any(in_threads(lambda may_be: may_be(), doubts))


def _may_be_off(lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp]) -> bool:
    """Tell whether views may be out of line, turned, scaled, of other brightness, or at mirrored places."""
    return _fault(lf, map_, y[::_FIRST], x[::_FIRST]) > _SURELY_RIGHT and _fault(lf, map_, y, x) > 1


def _fault(lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp]) -> float:
    """Measure how far views are out of line, turned, scaled or of other brightness, in units of what is worth a look.

    Noise between the views counts as well: mirrored places leave much of it.
    """
    offsets, radius = lf.offsets, float(np.hypot(*lf.size)) / 2
    parts = np.array_split(np.arange(len(lf.views)), -(-len(lf.views) * len(x) // _AT_ONCE))
    looks = in_threads(lambda some: _shown(lf, map_, some, y, x), parts)
    value, by_x, by_y, seen = (np.concatenate(shown) for shown in zip(*looks, strict=True))
    parallax = by_x * offsets[:, :1] + by_y * offsets[:, 1:]
    middle = (np.array(lf.size[::-1]) - 1) / 2
    across, down = (x - middle[0]) / radius, (y - middle[1]) / radius
    template = value[lf.reference_index]
    found, weight = np.zeros((len(value), 6)), seen
    rest = value - template
    for _ in range(_ROUNDS):
        # An error of a point's disparity, and what all views have in common, are no fault of a view.
        moved = (weight * parallax * rest).sum(0) / np.maximum((weight * parallax**2).sum(0), 1e-12)
        change = (weight * rest).sum(0) / np.maximum(weight.sum(0), 1e-12)
        left = rest - parallax * moved - change
        slopes = [by_x, by_y, by_y * across - by_x * down, by_x * across + by_y * down]
        jacobian = np.stack([*slopes, np.broadcast_to(template, value.shape), np.ones_like(value)], axis=1)
        weighted = jacobian * weight[:, None]
        normal = weighted @ jacobian.transpose(0, 2, 1) + 1e-6 * np.eye(6)
        found = np.linalg.solve(normal, weighted @ left[..., None])[..., 0]
        left = left - np.einsum("nk,nkp->np", found, jacobian)
        noise = max(_LEAST_NOISE, 1.4826 * float(np.median(np.abs(left[seen > 0]))))
        weight = seen / (1 + (left / (3 * noise)) ** 2) ** 2
    shift = consensus.without_gauge(found[:, :2], offsets)
    level = float(np.clip(np.median(template), 0.02, 1.0))
    bright = found[:, 4:5] + found[:, 5:] / level
    trends = consensus.smooth_rest(np.concatenate([shift, found[:, 2:4], bright], axis=1), offsets)
    shift, shape, bright = np.split(trends, [2, 4], axis=1)  # shape: at the half diagonal, pixels
    sizes = (
        (noise, 2 * _AGREE * float(np.median(np.hypot(by_x, by_y)))),
        (np.linalg.norm(shift, axis=1).max(), findings.MOVED),
        (consensus.usual_rest(shift), findings.OUT_OF_LINE),
        (np.abs(shape).max(), findings.TURNED),
        (max(consensus.usual_rest(column[:, None]) for column in shape.T), findings.OUT_OF_SHAPE),
        (np.abs(bright).max(), findings.BRIGHTER),
    )
    return max(float(size / max(_SHARE * limit, 1e-12)) for size, limit in sizes)


def _shown(
    lf: LightField, map_: NDArray[np.float32], index: NDArray[np.intp], y: NDArray[np.intp], x: NDArray[np.intp]
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Look up the values of views [n] at the points, smoothed, their derivatives, and 1 where they see them, [n, p]."""
    (du, dv), (height, width) = lf.offsets[index].T[..., None], lf.size
    d = map_[y, x].astype(np.float64)
    at_x, at_y = x - d * du, y - d * dv
    seen = (at_x >= 1) & (at_x < width - 2) & (at_y >= 1) & (at_y < height - 2) & ~hidden(lf, map_, y, x, index)
    at_x, at_y = at_x.clip(1, width - 2.01), at_y.clip(1, height - 2.01)
    if lf.valid is not None:
        taps = np.arange(-1, 3)
        rows, columns = (np.floor(at).astype(np.intp)[..., None] + taps for at in (at_y, at_x))
        seen &= lf.valid[index[:, None, None, None], rows[..., None], columns[..., None, :]].all(axis=(2, 3))
    picture = np.repeat(index, len(x))
    found = Surface(lf.views, lf.scale)(at_x.ravel(), at_y.ravel(), picture)
    value, by_x, by_y = (part.reshape(at_x.shape) for part in found)
    return value, by_x, by_y, seen.astype(np.float64)


def _may_be_swapped(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Tell whether far surfaces of the map may hide its near ones."""
    some = order_of_depth(lf, disparity, views=_SIDES, part=_PART)
    if some.told >= _TOLD and some.near.sum() < _BETTER * some.far.sum():
        return False
    order = order_of_depth(lf, disparity, views=_SIDES)
    return order.told >= _TOLD and order.near.sum() > _AS_GOOD * order.far.sum()
