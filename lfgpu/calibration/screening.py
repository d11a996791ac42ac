"""A screening of the cameras: whether a look at them may find anything at all.

Nearly all light fields are right, and a look (`lfgpu.calibration.quick_look.look`) takes longer than a fast map. The
screening compares all views with the reference at some hundred points, and reads no more of the views than these. One
linear step says how each view would have to move, turn, grow and change in brightness. Half of what would be a finding
makes it worth a look, and so does noise of that size.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration import consensus
from lfgpu.calibration.bundle import inner, on_surface, spline_weights, textured
from lfgpu.calibration.hiding import hidden, order_of_depth
from lfgpu.contract import Float64Array
from lfgpu.data.channels import mean_of_channels
from lfgpu.data.lightfield import LightField

MOVED, TURNED, BRIGHTER = 0.05, 0.07, 0.015
"""Pixels, pixels at the half diagonal, and share: half of what `findings` says is worth saying."""
OUT_OF_LINE, OUT_OF_SHAPE = 0.06, 0.1
"""Pixels, of all views together: half of the same."""
_POINTS, _FEWEST = 800, 200
_AGREE = 0.2  # pixels: views that differ from the reference by no more than this in the median have the right axes
_ROUNDS = 2  # of robust weights
_LEAST_NOISE = 0.003  # intensity
_SIDES = 4  # views, those farthest away, in which it is looked at what hides what
_TOLD = 50  # pixels that tell what hides what; from fewer nobody can tell
_AS_GOOD = 0.7  # of the loss: right cameras leave at most half of what the other order of depth leaves


def worth_a_look(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Whether something may be wrong with the cameras of a light field, by the map of its reference view [y, x]."""
    known = np.isfinite(disparity)
    if lf.valid is not None:
        known &= lf.valid[lf.reference_index]
    map_ = np.where(known, disparity, np.nanmin(disparity))
    y, x, _ = textured(lf, on_surface(lf, map_) & inner(known), _POINTS)
    return len(x) < _FEWEST or _may_be_off(lf, map_, y, x) or _may_be_swapped(lf, disparity)


def _may_be_off(lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp]) -> bool:
    """Whether views may be out of line, turned, scaled, of other brightness, or at mirrored places."""
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
        # What a disparity of each point that is a little off explains, and the mean of the views, are none of theirs.
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
        np.linalg.norm(shift, axis=1).max() > MOVED
        or consensus.usual_rest(shift) > OUT_OF_LINE
        or np.abs(shape).max() > TURNED
        or max(consensus.usual_rest(column[:, None]) for column in shape.T) > OUT_OF_SHAPE
        or np.abs(bright).max() > BRIGHTER
    )


def _shown(
    lf: LightField, map_: NDArray[np.float32], index: int, y: NDArray[np.intp], x: NDArray[np.intp]
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """What a view shows of the points, smoothed, its derivatives, and whether it sees them, [p] each."""
    (du, dv), (height, width) = lf.offsets[index], lf.size
    d = map_[y, x].astype(np.float64)
    at_x, at_y = x - d * du, y - d * dv
    inside = (at_x >= 1) & (at_x < width - 2) & (at_y >= 1) & (at_y < height - 2)
    x0, wx, sx = spline_weights(at_x.clip(1, width - 2.01))
    y0, wy, sy = spline_weights(at_y.clip(1, height - 2.01))
    four = np.arange(-1, 3)
    rows, columns = y0[:, None, None] + four[:, None], x0[:, None, None] + four
    taps = mean_of_channels(lf.views[index, rows, columns], np.float64) * lf.scale
    seen = inside & ~hidden(lf, map_, y, x, index)
    if lf.valid is not None:
        seen &= lf.valid[index, rows, columns].all(axis=(1, 2))
    by_row, slope = np.einsum("pji,ip->jp", taps, wx), np.einsum("pji,ip->jp", taps, sx)
    by_y = np.einsum("jp,jp->p", by_row, sy)
    return np.einsum("jp,jp->p", by_row, wy), np.einsum("jp,jp->p", slope, wy), by_y, seen.astype(np.float64)


def _may_be_swapped(lf: LightField, disparity: NDArray[np.float32]) -> bool:
    """Whether what the map takes for near may be hidden by what it takes for far."""
    order = order_of_depth(lf, disparity, views=_SIDES)
    return order.told >= _TOLD and order.near.sum() > _AS_GOOD * order.far.sum()


__all__ = ["worth_a_look"]
