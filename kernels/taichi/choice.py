"""Two maps of the same views, and the choice between them; `kernels/reference/choice.py` says what they are."""

from collections.abc import Sequence
from typing import Any

import taichi as ti

from lfgpu.contract import CLOSE, COMPARED, DECISIONS, FOLD, LEAST_ODDS

from .memory import DeviceArray, flat
from .runtime import once, run
from .sectors import place_of


@ti.func
def _arsinh(x: float):
    size = ti.abs(x)
    return ti.math.sign(x) * ti.log(size + ti.sqrt(size * size + 1.0))


@ti.func
def _log_odds(confidence: float, least: float):
    return ti.log((confidence + least) / (1.0 - confidence + least))


@ti.func
def _log_deviation(variance: float, farthest: float):
    return ti.log(ti.math.clamp(farthest * ti.sqrt(variance), 1e-3, 20.0))


@once
def _compare_kernel(stored: Any) -> Any:
    @ti.kernel
    def compare_kernel(
        map_0: flat(),
        confidence_0: flat(),
        variance_0: flat(),
        near_0: flat(),
        wide_0: flat(),
        map_1: flat(),
        confidence_1: flat(),
        variance_1: flat(),
        near_1: flat(),
        wide_1: flat(),
        least: float,
        farthest: float,
        span: float,
        height: int,
        width: int,
        rows: int,
        columns: int,
        features_out: flat(stored),
    ):
        for i in range(rows * columns * FOLD * FOLD):
            x = i % (FOLD * columns)
            y = i // (FOLD * columns)
            p = ti.min(y, height - 1) * width + ti.min(x, width - 1)
            apart = farthest * (map_1[p] - map_0[p])
            found = ti.Vector(
                [
                    _log_odds(confidence_0[p], least) / 4.0,
                    _log_odds(confidence_1[p], least) / 4.0,
                    _log_deviation(variance_0[p], farthest) / 3.0,
                    _log_deviation(variance_1[p], farthest) / 3.0,
                    _arsinh(apart / 0.05) / 4.0,
                    ti.log(1.0 + ti.abs(apart) / 0.03) / 4.0,
                    _arsinh(farthest * (map_0[p] - near_0[p]) / 0.1) / 4.0,
                    _arsinh(farthest * (map_1[p] - near_1[p]) / 0.1) / 4.0,
                    _arsinh(farthest * (map_0[p] - wide_0[p]) / 0.1) / 4.0,
                    _arsinh(farthest * (map_1[p] - wide_1[p]) / 0.1) / 4.0,
                    ti.log(farthest) / 2.0,
                    ti.log(1.0 + farthest * span) / 4.0,
                ]
            )
            for c in ti.static(range(COMPARED)):
                features_out[place_of(c, y, x, columns, COMPARED)] = ti.cast(found[c], stored)

    return compare_kernel


def compare_maps(
    first: Sequence[DeviceArray],
    second: Sequence[DeviceArray],
    *,
    farthest: float,
    span: float,
    features_out: DeviceArray,
) -> None:
    sizes = *first[0].shape, *features_out.shape[1:]
    # A compiler that knew LEAST_ODDS would add it to the other constant first, and lose digits.
    run(_compare_kernel(features_out.scalar), *first, *second, LEAST_ODDS, farthest, span, *sizes, features_out)


@ti.kernel
def _choose_kernel(
    decisions: flat(),
    first: flat(),
    second: flat(),
    farthest: float,
    columns: int,
    width: int,
    disparity_out: flat(),
    confidence_out: flat(),
    variance_out: flat(),
):
    for p in range(first.shape[0]):
        here = place_of(0, p // width, p % width, columns, DECISIONS)
        share = 1.0 / (1.0 + ti.exp(-decisions[here]))
        apart = second[p] - first[p]
        if farthest * ti.abs(apart) >= CLOSE:
            share = ti.select(share > 0.5, 1.0, 0.0)
        disparity_out[p] = first[p] + share * apart
        confidence_out[p] = 1.0 / (1.0 + ti.exp(-decisions[here + FOLD * FOLD]))
        deviation = ti.exp(ti.math.clamp(decisions[here + 2 * FOLD * FOLD], -7.0, 4.0)) / farthest
        variance_out[p] = deviation * deviation


def choose(
    decisions: DeviceArray,
    first: DeviceArray,
    second: DeviceArray,
    *,
    farthest: float,
    disparity_out: DeviceArray,
    confidence_out: DeviceArray,
    variance_out: DeviceArray,
) -> None:
    sizes = decisions.shape[2], first.shape[1]
    run(_choose_kernel, decisions, first, second, farthest, *sizes, disparity_out, confidence_out, variance_out)
