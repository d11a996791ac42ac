"""What the confidence is made of, on a CPU: many columns at a time.

`kernels/reference/confidence.py` says what it is.
"""

from typing import Any

import warp as wp

from .cost_volume import code
from .exponential import EXP, LOG
from .threads import in_slices, launch, load, slices

wp.set_module_options({"enable_backward": False})

SHARPNESS = wp.constant(2.0)
PATHS = wp.constant(8.0)
LEAST_CONFLICT = wp.constant(0.03)
LEAST_COST = wp.constant(1.0)
LEAST_BEND = wp.constant(1e-3)
LEAST_RELIEF = wp.constant(0.01)

_BLOCK = 128  # columns
_AROUND = 2  # pixels on each side, in which the nearest and the farthest are looked for

_EVIDENCE = (
    EXP
    + LOG
    + """
    const int width = volume.shape[2], count = volume.shape[0], columns = width - x < BLOCK ? width - x : BLOCK;
    const size_t size = (size_t)volume.shape[1] * width, place = (size_t)y * width + x;
    const float* const costs = volume.data + place;
    const float* const paths = path_costs.data + place;
    float least[BLOCK], least_path[BLOCK], rivals[BLOCK] = {};
    for (int j = 0; j < columns; ++j) {
        least[j] = costs[j];
        least_path[j] = paths[j];
    }
    for (int l = 1; l < count; ++l)
        for (int j = 0; j < columns; ++j) {
            least[j] = costs[l * size + j] < least[j] ? costs[l * size + j] : least[j];
            least_path[j] = paths[l * size + j] < least_path[j] ? paths[l * size + j] : least_path[j];
        }
    const float sharpness = SHARPNESS / unit;
    for (int l = 0; l < count; ++l)
        for (int j = 0; j < columns; ++j)
            rivals[j] += exp_of(sharpness * (least[j] - costs[l * size + j]));
    for (int j = 0; j < columns; ++j) {
        const float more = least_path[j] / PATHS - least[j], cost = least[j] / unit;
        conflict.data[place + j] = log_of((more > 0.f ? more : 0.f) / unit + LEAST_CONFLICT);
        evidence.data[place + j] = -log_of(step * rivals[j]);
        lowest.data[place + j] = log_of(cost > LEAST_COST ? cost : LEAST_COST);
    }
"""
)

_LINE_MEAN = """
    const int height = values.shape[0], width = values.shape[1], columns = width - x < BLOCK ? width - x : BLOCK;
    float total[BLOCK] = {};
    for (int k = -reach; k <= reach; ++k) {
        const int row = y + k * down, column = x + k * across;
        if (row < 0 || row >= height) continue;
        const float* const other = values.data + (long long)row * width + column;
        const int end = width - column < columns ? width - column : columns;
        for (int j = column < 0 ? -column : 0; j < end; ++j) total[j] += other[j];
    }
    const int size = down ? height : width;
    for (int j = 0; j < columns; ++j) {
        const int before = down ? y : x + j, after = size - 1 - before;
        const int count = 1 + (before < reach ? before : reach) + (after < reach ? after : reach);
        means.data[(size_t)y * width + x + j] = total[j] / count;
    }
"""

_UNEVENNESS = (
    LOG
    + """
    const int height = disparity.shape[0], width = disparity.shape[1], wide = width + 2 * AROUND;
    float* const logs = room.data;                 // [3, wide]: of row y in ring place y % 3, with a margin
    float* const nearest = logs + 3 * wide;        // [wide], of the rows around
    float* const farthest = nearest + wide;        // the same
    auto within = [](int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; };
    auto ring_of = [&](int y) { return logs + (y + 3) % 3 * wide + AROUND; };
    auto row_of = [&](int y) { return disparity.data + (size_t)within(y, height) * width; };
    int known = first - 1;                         // rows from here on are not in the ring
    for (int y = first; y < last; ++y) {
        for (; known <= y + 1; ++known) {          // beside the image, too, which goes on as at its border
            const float* const above = row_of(known - 1);
            const float* const level = row_of(known);
            const float* const below = row_of(known + 1);
            float* const out = ring_of(known);
            auto bend = [&](int x, int before, int after) {
                const float here = level[x];
                float sum = __builtin_fabsf((level[before] - here) + (level[after] - here));
                sum += __builtin_fabsf((above[x] - here) + (below[x] - here));
                sum += __builtin_fabsf((above[before] - here) + (below[after] - here));
                sum += __builtin_fabsf((above[after] - here) + (below[before] - here));
                return log_of(0.25f * sum + LEAST_BEND);
            };
            #pragma clang loop vectorize(assume_safety)
            for (int x = 1; x < width - 1; ++x) out[x] = bend(x, x - 1, x + 1);
            out[0] = bend(0, 0, within(1, width));
            out[width - 1] = bend(width - 1, within(width - 2, width), width - 1);
            out[-1] = bend(0, 0, 0);
            out[width] = bend(width - 1, width - 1, width - 1);
        }
        const float* const above = ring_of(y - 1);
        const float* const level = ring_of(y);
        const float* const below = ring_of(y + 1);
        float* const bends = bend_out.data + (size_t)y * width;
        #pragma clang loop vectorize(assume_safety)
        for (int x = 0; x < width; ++x)
            bends[x] = (above[x - 1] + above[x] + above[x + 1] + level[x - 1] + level[x] + level[x + 1]
                + below[x - 1] + below[x] + below[x + 1]) / 9.f;
        float* const high = nearest + AROUND;
        float* const low = farthest + AROUND;
        const float* const here = row_of(y);
        for (int x = 0; x < width; ++x) high[x] = low[x] = here[x];
        for (int k = -AROUND; k <= AROUND; ++k) {
            const float* const other = row_of(y + k);
            #pragma clang loop vectorize(assume_safety)
            for (int x = 0; x < width; ++x) {
                high[x] = other[x] > high[x] ? other[x] : high[x];
                low[x] = other[x] < low[x] ? other[x] : low[x];
            }
        }
        for (int k = 1; k <= AROUND; ++k) {
            high[-k] = high[0];
            high[width - 1 + k] = high[width - 1];
            low[-k] = low[0];
            low[width - 1 + k] = low[width - 1];
        }
        float* const reliefs = relief_out.data + (size_t)y * width;
        #pragma clang loop vectorize(assume_safety)
        for (int x = 0; x < width; ++x) {
            float most = high[x], least = low[x];
            #pragma unroll
            for (int k = -AROUND; k <= AROUND; ++k) {
                most = high[x + k] > most ? high[x + k] : most;
                least = low[x + k] < least ? low[x + k] : least;
            }
            reliefs[x] = log_of(most - least + LEAST_RELIEF);
        }
    }
"""
)


_NUMBERS = {
    "SHARPNESS": f"{SHARPNESS}f",
    "PATHS": f"{PATHS}f",
    "LEAST_CONFLICT": f"{LEAST_CONFLICT}f",
    "LEAST_COST": f"{LEAST_COST}f",
    "LEAST_BEND": f"{LEAST_BEND}f",
    "LEAST_RELIEF": f"{LEAST_RELIEF}f",
    "AROUND": _AROUND,
    "BLOCK": _BLOCK,
}


@wp.func_native(code(_EVIDENCE, **_NUMBERS))
def _evidence_of(
    volume: wp.array3d(dtype=float),
    path_costs: wp.array3d(dtype=float),
    step: float,
    unit: float,
    y: int,
    x: int,
    conflict: wp.array2d(dtype=float),
    evidence: wp.array2d(dtype=float),
    lowest: wp.array2d(dtype=float),
): ...


@wp.kernel
def evidence_kernel(
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
    y = row + wp.tid()
    for x in range(0, volume.shape[2], wp.static(_BLOCK)):
        _evidence_of(volume, path_costs, step, unit, y, x, conflict_out, evidence_out, cost_out)


@wp.func_native(code(_LINE_MEAN, **_NUMBERS))
def _line_mean_of(
    values: wp.array2d(dtype=float),
    down: int,
    across: int,
    reach: int,
    y: int,
    x: int,
    means: wp.array2d(dtype=float),
): ...


@wp.kernel
def line_mean_kernel(
    values: wp.array2d(dtype=float),
    down: int,
    across: int,
    reach: int,
    row: int,
    lanes: int,
    means_out: wp.array2d(dtype=float),
):
    y = row + wp.tid()
    for x in range(0, values.shape[1], wp.static(_BLOCK)):
        _line_mean_of(values, down, across, reach, y, x, means_out)


@wp.func_native(code(_UNEVENNESS, **_NUMBERS))
def _unevenness_of(
    disparity: wp.array2d(dtype=float),
    first: int,
    last: int,
    room: wp.array(dtype=float),
    bend_out: wp.array2d(dtype=float),
    relief_out: wp.array2d(dtype=float),
): ...


@wp.kernel
def _unevenness_kernel(
    disparity: wp.array2d(dtype=float),
    first: int,
    last: int,
    room: wp.array(dtype=float),
    bend_out: wp.array2d(dtype=float),
    relief_out: wp.array2d(dtype=float),
):
    """One thread works on the rows from `first` to before `last`."""
    _unevenness_of(disparity, first, last, room, bend_out, relief_out)


def unevenness(disparity: Any, bend_out: Any, relief_out: Any) -> None:
    (height, width), device = disparity.shape, disparity.device
    load(device, _unevenness_kernel)
    room = wp.empty((len(slices(device, height)), 5 * (width + 2 * _AROUND)), dtype=float, device=device)

    def some_rows(part: int, first: int, last: int) -> None:
        launch(_unevenness_kernel, 1, [disparity, first, last, room[part]], [bend_out, relief_out], device=device)

    in_slices(device, height, some_rows)
