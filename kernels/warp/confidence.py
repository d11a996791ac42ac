"""How far a disparity can be trusted; `kernels/reference/confidence.py` says how it is found.

`cpu_confidence.py` has what a CPU does in another way.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from . import cpu_confidence
from .cpu_confidence import LEAST_BEND, LEAST_CONFLICT, LEAST_COST, LEAST_RELIEF, PATHS, SHARPNESS
from .threads import launch_rows

wp.set_module_options({"enable_backward": False})

_NO_RIVAL = wp.constant(17.0)  # its share is lost in the rounding of the best one's
_MOST_COST = wp.constant(2.6)
_UNLIKE = wp.constant(12.0)
_BLIND = wp.constant(8.0)

_Weights = wp.types.vector(length=6, dtype=float)


@wp.kernel
def _evidence_kernel(
    volume: wp.array3d(dtype=float),
    path_costs: wp.array3d(dtype=float),
    step: float,
    unit: float,
    row: int,
    lanes: int,
    conflict_out: wp.array2d(dtype=float),
    evidence_out: wp.array2d(dtype=float),
    cost_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    count = volume.shape[0]
    for x in range(i % lanes, volume.shape[2], lanes):
        least = volume[0, y, x]
        least_path = path_costs[0, y, x]
        for k in range(1, count):
            least = wp.min(least, volume[k, y, x])
            least_path = wp.min(least_path, path_costs[k, y, x])
        rivals = float(0.0)
        for k in range(count):
            apart = SHARPNESS / unit * (volume[k, y, x] - least)
            if apart < _NO_RIVAL:
                rivals += wp.exp(-apart)
        conflict_out[y, x] = wp.log(wp.max(least_path / PATHS - least, 0.0) / unit + LEAST_CONFLICT)
        evidence_out[y, x] = -wp.log(step * rivals)
        cost_out[y, x] = wp.log(wp.max(least / unit, LEAST_COST))


_MEAN_ROW = """
    const int height = values.shape[0], width = values.shape[1], step = down * width + across;
    for (int x = lane; x < width; x += lanes) {
        const int place = down ? y : x, size = down ? height : width;
        const int from = place < reach ? -place : -reach, to = size - 1 - place < reach ? size - 1 - place : reach;
        const float* const here = values.data + (size_t)y * width + x;
        float total = 0.f;
        for (int k = from; k <= to; ++k) total += here[k * step];
        means.data[(size_t)y * width + x] = total / (float)(to - from + 1);
    }
"""


@wp.func_native(_MEAN_ROW)
def _mean_row(
    values: wp.array2d(dtype=float),
    down: int,
    across: int,
    reach: int,
    y: int,
    lane: int,
    lanes: int,
    means: wp.array2d(dtype=float),
): ...


@wp.kernel
def _line_mean_kernel(
    values: wp.array2d(dtype=float),
    down: int,
    across: int,
    reach: int,
    row: int,
    lanes: int,
    means_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    _mean_row(values, down, across, reach, row + i / lanes, i % lanes, lanes, means_out)


@wp.func
def _bend(disparity: wp.array2d(dtype=float), y: int, x: int):
    """The mean size of the second differences along rows, columns and diagonals, at a place held in the image."""
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


@wp.kernel
def _unevenness_kernel(
    disparity: wp.array2d(dtype=float),
    row: int,
    lanes: int,
    bend_out: wp.array2d(dtype=float),
    relief_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    height = disparity.shape[0]
    width = disparity.shape[1]
    for x in range(i % lanes, width, lanes):
        bends = float(0.0)
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                bends += wp.log(_bend(disparity, y + dy, x + dx) + LEAST_BEND)
        nearest = disparity[y, x]
        farthest = disparity[y, x]
        for qy in range(wp.max(y - 2, 0), wp.min(y + 3, height)):
            for qx in range(wp.max(x - 2, 0), wp.min(x + 3, width)):
                nearest = wp.max(nearest, disparity[qy, qx])
                farthest = wp.min(farthest, disparity[qy, qx])
        bend_out[y, x] = bends / 9.0
        relief_out[y, x] = wp.log(nearest - farthest + LEAST_RELIEF)


@wp.kernel
def _judge_kernel(
    conflict: wp.array2d(dtype=float),
    evidence: wp.array2d(dtype=float),
    bend: wp.array2d(dtype=float),
    relief: wp.array2d(dtype=float),
    wide: wp.array2d(dtype=float),
    cost: wp.array2d(dtype=float),
    span: float,
    share: _Weights,
    spread: _Weights,
    row: int,
    lanes: int,
    confidence_out: wp.array2d(dtype=float),
    variance_out: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, conflict.shape[1], lanes):
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
    unit: float,
    conflict_out: Any,
    evidence_out: Any,
    cost_out: Any,
) -> None:
    kernel = cpu_confidence.evidence_kernel if volume.device.is_cpu else _evidence_kernel
    launch_rows(kernel, [volume, path_costs, step, unit], conflict_out, evidence_out, cost_out)


def line_mean(values: Any, *, axis: int, reach: int, means_out: Any) -> None:
    kernel = cpu_confidence.line_mean_kernel if values.device.is_cpu else _line_mean_kernel
    launch_rows(kernel, [values, 1 - axis, axis, reach], means_out)


def unevenness(disparity: Any, *, bend_out: Any, relief_out: Any) -> None:
    if disparity.device.is_cpu:
        cpu_confidence.unevenness(disparity, bend_out, relief_out)
    else:
        launch_rows(_unevenness_kernel, [disparity], bend_out, relief_out)


def judge(
    conflict: Any,
    evidence: Any,
    bend: Any,
    relief: Any,
    wide: Any,
    cost: Any,
    *,
    span: float,
    share: Sequence[float],
    spread: Sequence[float],
    confidence_out: Any,
    variance_out: Any,
) -> None:
    inputs = [conflict, evidence, bend, relief, wide, cost, span, _Weights(*share), _Weights(*spread)]
    launch_rows(_judge_kernel, inputs, confidence_out, variance_out)
