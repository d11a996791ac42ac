"""Confidence and variance of a disparity map, as `kernels/reference/confidence.py` defines them.

A CPU does in C++, for many columns at a time, what a GPU does in Warp's language.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .native_code import kernel
from .pixels import Field, Number, Volume, pixelwise
from .threads import launch_rows, launch_slices, room_for
from .vector import given

wp.set_module_options({"enable_backward": False})

_SHARPNESS = wp.constant(2.0)
_PATHS = wp.constant(8.0)
_LEAST_CONFLICT = wp.constant(0.03)
_LEAST_COST = wp.constant(1.0)
_LEAST_BEND = wp.constant(1e-3)
_LEAST_RELIEF = wp.constant(0.01)
_NO_RIVAL = wp.constant(17.0)  # its share is lost in the rounding of the best one's
_MOST_COST = wp.constant(2.6)
_UNLIKE = wp.constant(12.0)
_BLIND = wp.constant(8.0)

_BLOCK = 128  # columns of a CPU
_AROUND = 2  # pixels on each side, in which the nearest and the farthest are looked for

_Weights = wp.types.vector(length=6, dtype=float)


def _cpu_kernel(name: str) -> Any:
    numbers = {
        "SHARPNESS": _SHARPNESS,
        "PATHS": _PATHS,
        "LEAST_CONFLICT": _LEAST_CONFLICT,
        "LEAST_COST": _LEAST_COST,
        "LEAST_BEND": _LEAST_BEND,
        "LEAST_RELIEF": _LEAST_RELIEF,
        "AROUND": _AROUND,
        "BLOCK": _BLOCK,
    }
    return kernel("confidence.h", name, **numbers)


def _line_mean_kernel() -> Any:
    return kernel("confidence.cuh", "average_line")


@pixelwise("lfgpu_evidence")
def _weigh_evidence(
    y: int,
    x: int,
    volume: Volume,
    path_costs: Volume,
    labels: Number,
    step: float,
    unit: Number,
    conflict_out: Field,
    evidence_out: Field,
    cost_out: Field,
):
    count = int(labels)
    least = volume[0, y, x]
    least_path = path_costs[0, y, x]
    for k in range(1, count):
        least = wp.min(least, volume[k, y, x])
        least_path = wp.min(least_path, path_costs[k, y, x])
    rivals = float(0.0)
    for k in range(count):
        apart = _SHARPNESS / unit * (volume[k, y, x] - least)
        if apart < _NO_RIVAL:
            rivals += wp.exp(-apart)
    conflict_out[y, x] = wp.log(wp.max(least_path / _PATHS - least, 0.0) / unit + _LEAST_CONFLICT)
    evidence_out[y, x] = -wp.log(step * rivals)
    cost_out[y, x] = wp.log(wp.max(least / unit, _LEAST_COST))


@wp.func
def _bend(disparity: wp.array2d(dtype=float), y: int, x: int):
    """Average the second differences along rows, columns and diagonals, at a place held in the image."""
    bottom = disparity.shape[0] - 1
    right = disparity.shape[1] - 1
    here = disparity[wp.clamp(y, 0, bottom), wp.clamp(x, 0, right)]
    above = wp.clamp(y - 1, 0, bottom)
    level = wp.clamp(y, 0, bottom)
    below = wp.clamp(y + 1, 0, bottom)
    before = wp.clamp(x - 1, 0, right)
    middle = wp.clamp(x, 0, right)
    after = wp.clamp(x + 1, 0, right)
    bend = wp.abs((disparity[level, before] - here) + (disparity[level, after] - here))
    bend += wp.abs((disparity[above, middle] - here) + (disparity[below, middle] - here))
    bend += wp.abs((disparity[above, before] - here) + (disparity[below, after] - here))
    bend += wp.abs((disparity[above, after] - here) + (disparity[below, before] - here))
    return bend / 4.0


@pixelwise("lfgpu_unevenness")
def _find_unevenness(y: int, x: int, disparity: Field, bend_out: Field, relief_out: Field):
    bends = float(0.0)
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            bends += wp.log(_bend(disparity, y + dy, x + dx) + _LEAST_BEND)
    nearest = disparity[y, x]
    farthest = disparity[y, x]
    for qy in range(wp.max(y - 2, 0), wp.min(y + 3, disparity.shape[0])):
        for qx in range(wp.max(x - 2, 0), wp.min(x + 3, disparity.shape[1])):
            nearest = wp.max(nearest, disparity[qy, qx])
            farthest = wp.min(farthest, disparity[qy, qx])
    bend_out[y, x] = bends / 9.0
    relief_out[y, x] = wp.log(nearest - farthest + _LEAST_RELIEF)


@pixelwise("lfgpu_judge")
def _judge(
    y: int,
    x: int,
    conflict: Field,
    evidence: Field,
    bend: Field,
    relief: Field,
    wide: Field,
    cost: Field,
    span: Number,
    share: _Weights,
    spread: _Weights,
    confidence_out: Field,
    variance_out: Field,
):
    features = _Weights(1.0, conflict[y, x], evidence[y, x], bend[y, x], relief[y, x], bend[y, x] * relief[y, x])
    unknown = 0.5 * wp.pow(wp.min(wp.exp(-wide[y, x]) / span, 1.0), _BLIND)
    known = 1.0 - unknown
    alike = 1.0 / (1.0 + wp.pow(wp.exp(cost[y, x]) / _MOST_COST, _UNLIKE))
    confidence_out[y, x] = alike * known / (1.0 + wp.exp(-wp.dot(share, features)))
    variance_out[y, x] = known * wp.exp(wp.dot(spread, features)) + unknown * span * span / 12.0


def evidence(
    volume: Any,
    path_costs: Any,
    *,
    step: float,
    unit: Any,
    conflict_out: Any,
    evidence_out: Any,
    cost_out: Any,
    labels: Any = None,
) -> None:
    count, outputs = len(volume) if labels is None else labels, [conflict_out, evidence_out, cost_out]
    if volume.device.is_cpu:
        inputs = [volume, path_costs, *given(count), step, *given(unit)]
        launch_rows(_cpu_kernel("weigh_evidence"), inputs, *outputs)
    else:
        _weigh_evidence(volume, path_costs, count, step, unit, *outputs)


def line_mean(values: Any, *, axis: int, reach: int, means_out: Any) -> None:
    average = _cpu_kernel("average_line") if values.device.is_cpu else _line_mean_kernel()
    launch_rows(average, [values, 1 - axis, axis, reach], means_out)


def unevenness(disparity: Any, *, bend_out: Any, relief_out: Any) -> None:
    if not disparity.device.is_cpu:
        _find_unevenness(disparity, bend_out, relief_out)
        return
    (height, width), find = disparity.shape, _cpu_kernel("find_unevenness")
    room = room_for(disparity.device, 5 * (width + 2 * _AROUND))
    launch_slices(find, height, [disparity], bend_out, relief_out, room=room)


def judge(maps: Sequence[Any], *, share: Sequence[float], spread: Sequence[float], **given: Any) -> None:
    _judge(*maps, share=_Weights(*share), spread=_Weights(*spread), **given)
