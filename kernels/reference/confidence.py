"""Confidence and variance of a disparity map, from its costs and its shape: NumPy, float64."""

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import Float64Array as Array

SHARPNESS = 2.0  # costs that differ by unit / SHARPNESS differ
PATHS = 8  # whose costs are added up
LEAST_CONFLICT = 0.03  # units: less is none
LEAST_COST = 1.0  # units: views that differ by less than their noise say no more than that
MOST_COST = 2.6  # units: views that differ by more at best show different things
UNLIKE = 12  # power of the costs in units of that
BLIND = 8  # power of the share of disparities that are as good as the best one: nearly all of them must be
LEAST_BEND = 1e-3  # pixels per view step: less is the noise of a map
LEAST_RELIEF = 0.01  # pixels per view step: less than what counts


def evidence(
    volume: Array,
    path_costs: Array,
    *,
    step: float,
    unit: float,
    conflict_out: Array,
    evidence_out: Array,
    cost_out: Array,
) -> None:
    least = volume.min(0)
    cost_out[:] = np.log(np.maximum(least / unit, LEAST_COST))
    conflict_out[:] = np.log(np.maximum(path_costs.min(0) / PATHS - least, 0) / unit + LEAST_CONFLICT)
    evidence_out[:] = -np.log(step * np.exp(-SHARPNESS / unit * (volume - least)).sum(0))


def line_mean(values: Array, *, axis: int, reach: int, means_out: Array) -> None:
    total, count = np.zeros_like(values), np.zeros_like(values)
    from_axis, to_axis, sums, counts = (np.moveaxis(a, axis, 0) for a in (values, means_out, total, count))
    length = len(from_axis)
    for step in range(-reach, reach + 1):
        here, there = (slice(max(0, sign * step), length + min(0, sign * step)) for sign in (-1, 1))
        if abs(step) < length:
            sums[here] += from_axis[there]
            counts[here] += 1
    to_axis[:] = sums / counts


def unevenness(disparity: Array, *, bend_out: Array, relief_out: Array) -> None:
    height, width = disparity.shape
    around = np.pad(disparity, 2, mode="edge")

    def moved(y: int, x: int) -> Array:
        """Add one pixel on each side of the image."""
        return around[1 + y : height + 3 + y, 1 + x : width + 3 + x]

    ways = ((0, 1), (1, 0), (1, 1), (1, -1))
    bends = sum(np.abs(moved(y, x) - 2 * moved(0, 0) + moved(-y, -x)) for y, x in ways) / len(ways)
    logs = np.log(bends + LEAST_BEND)
    bend_out[:] = np.lib.stride_tricks.sliding_window_view(logs, (3, 3)).mean((2, 3))
    window = np.lib.stride_tricks.sliding_window_view(around, (5, 5))
    relief_out[:] = np.log(window.max((2, 3)) - window.min((2, 3)) + LEAST_RELIEF)


def judge(
    maps: Sequence[Array],
    *,
    span: float,
    share: Sequence[float],
    spread: Sequence[float],
    confidence_out: Array,
    variance_out: Array,
) -> None:
    conflict, evidence, bend, relief, wide, cost = maps
    features = np.ones_like(conflict), conflict, evidence, bend, relief, bend * relief
    unknown = np.minimum(np.exp(-wide) / span, 1) ** BLIND / 2
    log_odds, log_variance = (sum(weight * f for weight, f in zip(w, features, strict=True)) for w in (share, spread))
    alike = 1 / (1 + (np.exp(cost) / MOST_COST) ** UNLIKE)
    confidence_out[:] = alike * (1 - unknown) / (1 + np.exp(-log_odds))
    variance_out[:] = (1 - unknown) * np.exp(log_variance) + unknown * span**2 / 12
