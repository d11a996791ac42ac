"""Confidence and variance of a disparity map, as `kernels/reference/confidence.py` defines them."""

from collections.abc import Sequence
from typing import Any

import taichi as ti

from .memory import DeviceArray, flat, operation

_SHARPNESS = 2.0
_PATHS = 8.0
_LEAST_CONFLICT = 0.03
_LEAST_COST = 1.0
_MOST_COST = 2.6
_UNLIKE = 12.0
_BLIND = 8.0
_LEAST_BEND = 1e-3
_LEAST_RELIEF = 0.01


@operation
@ti.kernel
def evidence(
    volume: flat(),
    path_costs: flat(),
    step: float,
    unit: float,
    conflict_out: flat(),
    evidence_out: flat(),
    cost_out: flat(),
):
    size = conflict_out.shape[0]
    for p in range(size):
        count = volume.shape[0] // size
        least = volume[p]
        least_path = path_costs[p]
        for k in range(1, count):
            least = ti.min(least, volume[k * size + p])
            least_path = ti.min(least_path, path_costs[k * size + p])
        rivals = 0.0
        for k in range(count):
            rivals += ti.exp(-_SHARPNESS / unit * (volume[k * size + p] - least))
        conflict_out[p] = ti.log(ti.max(least_path / _PATHS - least, 0.0) / unit + _LEAST_CONFLICT)
        evidence_out[p] = -ti.log(step * rivals)
        cost_out[p] = ti.log(ti.max(least / unit, _LEAST_COST))


@operation
@ti.kernel
def line_mean(values: flat(), axis: int, reach: int, height: int, width: int, means_out: flat()):
    for p in range(means_out.shape[0]):
        total = 0.0
        count = 0.0
        for k in range(-reach, reach + 1):
            x = p % width + k * axis
            y = p // width + k * (1 - axis)
            if y >= 0 and y < height and x >= 0 and x < width:
                total += values[y * width + x]
                count += 1.0
        means_out[p] = total / count


@ti.func
def _at(disparity: ti.template(), y: int, x: int, height: int, width: int):
    return disparity[ti.min(ti.max(y, 0), height - 1) * width + ti.min(ti.max(x, 0), width - 1)]


@operation
@ti.kernel
def unevenness(disparity: flat(), height: int, width: int, bend_out: flat(), relief_out: flat()):
    for p in range(bend_out.shape[0]):
        x = p % width
        y = p // width
        bends = 0.0
        nearest = disparity[p]
        farthest = disparity[p]
        for qy in range(y - 2, y + 3):
            for qx in range(x - 2, x + 3):
                here = _at(disparity, qy, qx, height, width)
                nearest = ti.max(nearest, here)
                farthest = ti.min(farthest, here)
                if ti.abs(qy - y) < 2 and ti.abs(qx - x) < 2:
                    bend = 0.0
                    for dy, dx in ti.static(((0, 1), (1, 0), (1, 1), (1, -1))):
                        ahead = _at(disparity, qy + dy, qx + dx, height, width)
                        behind = _at(disparity, qy - dy, qx - dx, height, width)
                        bend += ti.abs((ahead - here) + (behind - here))
                    bends += ti.log(bend / 4.0 + _LEAST_BEND)
        bend_out[p] = bends / 9.0
        relief_out[p] = ti.log(nearest - farthest + _LEAST_RELIEF)


@operation
@ti.kernel
def _judge(
    conflict: flat(),
    evidence: flat(),
    bend: flat(),
    relief: flat(),
    wide: flat(),
    cost: flat(),
    span: float,
    share: ti.types.vector(6, float),
    spread: ti.types.vector(6, float),
    confidence_out: flat(),
    variance_out: flat(),
):
    for p in range(conflict.shape[0]):
        features = ti.Vector([1.0, conflict[p], evidence[p], bend[p], relief[p], bend[p] * relief[p]])
        unknown = 0.5 * ti.min(ti.exp(-wide[p]) / span, 1.0) ** _BLIND
        alike = 1.0 / (1.0 + (ti.exp(cost[p]) / _MOST_COST) ** _UNLIKE)
        confidence_out[p] = alike * (1.0 - unknown) / (1.0 + ti.exp(-share.dot(features)))
        variance_out[p] = (1.0 - unknown) * ti.exp(spread.dot(features)) + unknown * span * span / 12.0


def judge(maps: Sequence[DeviceArray], *, share: Sequence[float], spread: Sequence[float], **given: Any) -> None:
    _judge(*maps, share=ti.Vector(list(share)), spread=ti.Vector(list(spread)), **given)
