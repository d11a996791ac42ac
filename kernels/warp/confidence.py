"""How far a disparity can be trusted; `kernels/reference/confidence.py` says how it is found."""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .threads import launch_rows

wp.set_module_options({"enable_backward": False})

_SHARPNESS = wp.constant(2.0)
_LEAST_COST = wp.constant(1.0)
_NO_RIVAL = wp.constant(17.0)  # its share is lost in the rounding of the best one's


@wp.kernel
def _evidence_kernel(
    volume: wp.array3d(dtype=float),
    disparity: wp.array2d(dtype=float),
    first: float,
    step: float,
    unit: float,
    row: int,
    lanes: int,
    cost_out: wp.array2d(dtype=float),
    evidence_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    count = volume.shape[0]
    for x in range(i % lanes, volume.shape[2], lanes):
        place = wp.clamp((disparity[y, x] - first) / step, 0.0, float(count - 1))
        below = wp.min(int(place), count - 2)
        part = place - float(below)
        cost_out[y, x] = ((1.0 - part) * volume[below, y, x] + part * volume[below + 1, y, x]) / unit
        least = volume[0, y, x]
        for k in range(1, count):
            least = wp.min(least, volume[k, y, x])
        rivals = float(0.0)
        for k in range(count):
            apart = _SHARPNESS / unit * (volume[k, y, x] - least)
            if apart < _NO_RIVAL:
                rivals += wp.exp(-apart)
        evidence_out[y, x] = 1.0 / (step * rivals)


@wp.kernel
def _judge_kernel(
    odds: wp.array2d(dtype=float),
    cost: wp.array2d(dtype=float),
    evidence: wp.array2d(dtype=float),
    share: wp.vec4,
    spread: wp.vec4,
    row: int,
    lanes: int,
    confidence_out: wp.array2d(dtype=float),
    variance_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, odds.shape[1], lanes):
        features = wp.vec4(1.0, -wp.log(odds[y, x]), wp.log(wp.max(cost[y, x], _LEAST_COST)), wp.log(evidence[y, x]))
        confidence_out[y, x] = 1.0 / (1.0 + wp.exp(-wp.dot(share, features)))
        variance_out[y, x] = wp.exp(wp.dot(spread, features))


def evidence(
    volume: Any, disparity: Any, *, first: float, step: float, unit: float, cost_out: Any, evidence_out: Any
) -> None:
    launch_rows(_evidence_kernel, [volume, disparity, first, step, unit], cost_out, evidence_out)


def judge(
    odds: Any,
    cost: Any,
    evidence: Any,
    *,
    share: Sequence[float],
    spread: Sequence[float],
    confidence_out: Any,
    variance_out: Any,
) -> None:
    inputs = [odds, cost, evidence, wp.vec4(*share), wp.vec4(*spread)]
    launch_rows(_judge_kernel, inputs, confidence_out, variance_out)
