"""How far a disparity can be trusted; `kernels/reference/confidence.py` says how it is found."""

from collections.abc import Sequence

import taichi as ti

from .memory import DeviceArray, flat
from .runtime import run

_SHARPNESS = 2.0
_LEAST_COST = 1.0


@ti.kernel
def _evidence_kernel(
    volume: flat(), disparity: flat(), first: float, step: float, unit: float, cost_out: flat(), evidence_out: flat()
):
    size = disparity.shape[0]
    for p in range(size):
        count = volume.shape[0] // size
        place = ti.min(ti.max((disparity[p] - first) / step, 0.0), ti.cast(count - 1, ti.f32))
        below = ti.min(ti.cast(place, ti.i32), count - 2)
        part = place - ti.cast(below, ti.f32)
        here = below * size + p
        cost_out[p] = ((1.0 - part) * volume[here] + part * volume[here + size]) / unit
        least = volume[p]
        for k in range(1, count):
            least = ti.min(least, volume[k * size + p])
        rivals = 0.0
        for k in range(count):
            rivals += ti.exp(-_SHARPNESS / unit * (volume[k * size + p] - least))
        evidence_out[p] = 1.0 / (step * rivals)


@ti.kernel
def _judge_kernel(
    odds: flat(),
    cost: flat(),
    evidence: flat(),
    share: ti.types.vector(4, float),
    spread: ti.types.vector(4, float),
    confidence_out: flat(),
    variance_out: flat(),
):
    for p in range(odds.shape[0]):
        features = ti.Vector([1.0, -ti.log(odds[p]), ti.log(ti.max(cost[p], _LEAST_COST)), ti.log(evidence[p])])
        confidence_out[p] = 1.0 / (1.0 + ti.exp(-share.dot(features)))
        variance_out[p] = ti.exp(spread.dot(features))


def evidence(
    volume: DeviceArray,
    disparity: DeviceArray,
    *,
    first: float,
    step: float,
    unit: float,
    cost_out: DeviceArray,
    evidence_out: DeviceArray,
) -> None:
    run(_evidence_kernel, volume.values, disparity.values, first, step, unit, cost_out.values, evidence_out.values)


def judge(
    odds: DeviceArray,
    cost: DeviceArray,
    evidence: DeviceArray,
    *,
    share: Sequence[float],
    spread: Sequence[float],
    confidence_out: DeviceArray,
    variance_out: DeviceArray,
) -> None:
    run(
        _judge_kernel,
        odds.values,
        cost.values,
        evidence.values,
        ti.Vector(list(share)),
        ti.Vector(list(spread)),
        confidence_out.values,
        variance_out.values,
    )
