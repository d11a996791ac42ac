"""The peak of the distribution of each pixel over disparities; `kernels/reference/peak.py` says what it is."""

import math
from collections.abc import Sequence
from typing import Any

import taichi as ti

from lfgpu.contract import FOLD, LEAST_ODDS, LEAST_WIDTH, PEAK_REACH, Rows

from .memory import DeviceArray, flat, operation
from .runtime import once, run


@once
def _kernel(stored: Any) -> Any:
    @ti.kernel
    def peak_kernel(
        logits: flat(stored),
        first: flat(),
        step: float,
        begin: int,
        end: int,
        labels: int,
        rows: int,
        columns: int,
        width: int,
        disparity_out: flat(),
        probability_out: flat(),
        deviation_out: flat(),
    ):
        for p in range(begin, end):
            y = p // width
            x = p % width
            here = (y // FOLD % rows * columns + x // FOLD) * FOLD * FOLD + y % FOLD * FOLD + x % FOLD
            apart = rows * columns * FOLD * FOLD
            best = 0
            most = ti.cast(logits[here], ti.f32)
            for k in range(1, labels):
                value = ti.cast(logits[here + k * apart], ti.f32)
                if value > most:
                    most = value
                    best = k
            total = 0.0
            for k in range(labels):
                total += ti.exp(ti.cast(logits[here + k * apart], ti.f32) - most)
            shares = ti.Vector([0.0 for _ in range(2 * PEAK_REACH + 1)])
            place = 0.0
            for k in ti.static(range(2 * PEAK_REACH + 1)):
                near = best + k - PEAK_REACH
                if near >= 0 and near < labels:
                    shares[k] = ti.exp(ti.cast(logits[here + near * apart], ti.f32) - most)
                    place += (k - PEAK_REACH) * shares[k]
            place /= shares.sum()
            square = 0.0
            for k in ti.static(range(2 * PEAK_REACH + 1)):
                square += (k - PEAK_REACH - place) ** 2 * shares[k]
            disparity_out[p] = first[p] + step * (ti.cast(best, ti.f32) + place)
            probability_out[p] = shares.sum() / total
            deviation_out[p] = step * ti.sqrt(square / shares.sum())

    return peak_kernel


def peak(
    logits: DeviceArray,
    first: DeviceArray,
    *,
    step: float,
    disparity_out: DeviceArray,
    probability_out: DeviceArray,
    deviation_out: DeviceArray,
    rows: Rows | None = None,
) -> None:
    height, width = first.shape
    top, bottom = (0, height) if rows is None else (min(FOLD * row, height) for row in (rows.first, rows.last))
    sizes = top * width, bottom * width, *logits.shape, width
    run(_kernel(logits.scalar), logits, first, step, *sizes, disparity_out, probability_out, deviation_out)


@operation
@ti.kernel
def _judge_peak(
    probability: flat(),
    deviation: flat(),
    step: float,
    least: float,
    share: ti.types.vector(3, float),
    spread: ti.types.vector(3, float),
    confidence_out: flat(),
    variance_out: flat(),
):
    for p in range(probability.shape[0]):
        odds = ti.log((probability[p] + least) / (1.0 - probability[p] + least))
        features = ti.Vector([1.0, odds, ti.log(deviation[p] / step + LEAST_WIDTH)])
        confidence_out[p] = 1.0 / (1.0 + ti.exp(-share.dot(features)))
        variance_out[p] = step * step * ti.exp(spread.dot(features))


def judge_peak(
    probability: DeviceArray,
    deviation: DeviceArray,
    *,
    step: float,
    limit: float,
    share: Sequence[float],
    spread: Sequence[float],
    **outputs: DeviceArray,
) -> None:
    at_limit = share[0] + share[3] * math.log(limit / step), share[1], share[2]
    # A compiler that knew LEAST_ODDS would add it to the other constant first, and lose digits.
    numbers = step, LEAST_ODDS, ti.Vector(list(at_limit)), ti.Vector(list(spread))
    _judge_peak(probability, deviation, *numbers, **outputs)
