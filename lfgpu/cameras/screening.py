"""Screening of the cameras: a test at some hundred points that says whether a look at them can find anything.

Nearly all light fields are right, and a look takes longer than a fast map. The screening compares all views with the
reference, and reads only the pixels around its points. One linear step tells how each view would have to move, turn,
grow and change in brightness. Half of a finding makes the cameras worth a look, and so does noise of that size.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras import consensus, findings
from lfgpu.cameras.points import hidden, on_surfaces
from lfgpu.cameras.signs import order_of_depth
from lfgpu.cameras.surface import Surface
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField

_SHARE = 0.5  # of a finding
_POINTS, _FEWEST = 800, 200
_AGREE = 0.2  # pixels: views that differ from the reference by no more than this in the median have the right axes
_ROUNDS = 2  # of robust weights
_LEAST_NOISE = 0.003  # intensity
_SIDES = 4  # views, those farthest away, in which the order of depth is compared
_TOLD = 50  # pixels that tell the order of depth; from fewer nobody can tell
_AS_GOOD = 0.7  # of the loss: right cameras leave at most half of what the other order of depth leaves


def worth_a_look(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Tell whether something may be wrong with the cameras, by the map of the reference view [y, x]."""
    map_, y, x, _ = on_surfaces(lf, disparity, _POINTS)
    return len(x) < _FEWEST or _may_be_off(lf, map_, y, x) or _may_be_swapped(lf, disparity)


def _may_be_off(lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp]) -> bool:
    """Tell whether views may be out of line, turned, scaled, of other brightness, or at mirrored places."""
    offsets, radius = lf.offsets, float(np.hypot(*lf.size)) / 2
    looks = [_shown(lf, map_, n, y, x) for n in range(len(lf.views))]
    value, by_x, by_y, seen = (np.stack(parts) for parts in zip(*looks, strict=True))
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
    if noise > _AGREE * float(np.median(np.hypot(by_x, by_y))):
        return True
    shift = consensus.smooth_rest(consensus.without_gauge(found[:, :2], offsets), offsets)
    shape = consensus.smooth_rest(found[:, 2:4], offsets)  # at the half diagonal, pixels
    level = float(np.clip(np.median(template), 0.02, 1.0))
    bright = consensus.smooth_rest((found[:, 4] + found[:, 5] / level)[:, None], offsets)
    return bool(
        np.linalg.norm(shift, axis=1).max() > _SHARE * findings.MOVED
        or consensus.usual_rest(shift) > _SHARE * findings.OUT_OF_LINE
        or np.abs(shape).max() > _SHARE * findings.TURNED
        or max(consensus.usual_rest(column[:, None]) for column in shape.T) > _SHARE * findings.OUT_OF_SHAPE
        or np.abs(bright).max() > _SHARE * findings.BRIGHTER
    )


def _shown(
    lf: LightField, map_: NDArray[np.float32], index: int, y: NDArray[np.intp], x: NDArray[np.intp]
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Value of a view at the points, smoothed, its derivatives, and 1 where it sees them, [p] each."""
    (du, dv), (height, width) = lf.offsets[index], lf.size
    d = map_[y, x].astype(np.float64)
    at_x, at_y = x - d * du, y - d * dv
    seen = (at_x >= 1) & (at_x < width - 2) & (at_y >= 1) & (at_y < height - 2) & ~hidden(lf, map_, y, x, index)
    at_x, at_y = at_x.clip(1, width - 2.01), at_y.clip(1, height - 2.01)
    if lf.valid is not None:
        taps = np.arange(-1, 3)
        rows, columns = np.floor(at_y).astype(np.intp)[:, None] + taps, np.floor(at_x).astype(np.intp)[:, None] + taps
        seen &= lf.valid[index, rows[:, :, None], columns[:, None]].all(axis=(1, 2))
    return *Surface(lf.views[index], lf.scale)(at_x, at_y), seen.astype(np.float64)


def _may_be_swapped(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Tell whether far surfaces of the map may hide its near ones."""
    order = order_of_depth(lf, disparity, views=_SIDES)
    return order.told >= _TOLD and order.near.sum() > _AS_GOOD * order.far.sum()


__all__ = ["worth_a_look"]
