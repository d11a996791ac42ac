"""Cost volumes: averages of like pixels, and the least; `kernels/reference/cost_volume.py` says which."""

import taichi as ti

from lfgpu.contract import REDUCTION

from .landing import inside
from .memory import DeviceArray, flat, operation, scratch
from .nlm import step_after, step_of
from .runtime import TASK, on_cpu, run

_SLICES = 8  # of the volume, for which a thread of a GPU reads weights once


@ti.kernel
def _total_kernel(weights: flat(), height: int, width: int, radius: int, totals_out: flat()):
    """Compute the weights of each pixel's window, itself included."""
    size = height * width
    for p in range(totals_out.shape[0]):
        x = p % width
        y = p // width
        total = 1.0
        step = step_of(0, radius)
        for k in range(weights.shape[0] // size):
            total += weights[k * size + p]  # 0 where the neighbour is outside
            if inside(x - step[0], y - step[1], height, width):
                total += weights[k * size + p - step[1] * width - step[0]]
            step = step_after(step, radius)
        totals_out[p] = total


@ti.kernel
def _rows_kernel(
    weights: flat(), volume: flat(), totals: flat(), height: int, width: int, radius: int, average_out: flat()
):
    """Compute a row of all slices on each thread of a CPU; the window is the outer loop, so weights lie in a row."""
    size = height * width
    for task in range(height * TASK):
        if task % TASK == 0:
            y = task // TASK
            row = y * width
            for s in range(volume.shape[0] // size):
                here = s * size + row
                for x in range(width):
                    average_out[here + x] = volume[here + x]
                for k in range(weights.shape[0] // size):
                    step = step_of(k, radius)
                    dx = step[0]
                    away = step[1] * width + dx
                    if y + step[1] < height:
                        for x in range(ti.max(0, -dx), ti.min(width, width - dx)):
                            added = weights[k * size + row + x] * volume[here + away + x]
                            average_out[here + x] = average_out[here + x] + added
                    if y - step[1] >= 0:
                        for x in range(ti.max(0, dx), ti.min(width, width + dx)):
                            added = weights[k * size + row - away + x] * volume[here - away + x]
                            average_out[here + x] = average_out[here + x] + added
                for x in range(width):
                    average_out[here + x] = average_out[here + x] / totals[row + x]


@ti.kernel
def _pixels_kernel(
    weights: flat(), volume: flat(), totals: flat(), height: int, width: int, radius: int, average_out: flat()
):
    """Compute a pixel of some slices on each thread of a GPU."""
    size = height * width
    count = volume.shape[0] // size
    parts = (count + _SLICES - 1) // _SLICES
    for i in range(parts * size):
        part = i // size
        p = i - part * size
        x = p % width
        y = p // width
        first = count * part // parts
        last = count * (part + 1) // parts
        slices = ti.Vector([0 for _ in range(_SLICES)])
        sums = ti.Vector([0.0 for _ in range(_SLICES)])
        for s in ti.static(range(_SLICES)):
            slices[s] = ti.min(first + s, last - 1) * size + p  # the last one again where there are fewer
            sums[s] = volume[slices[s]]
        step = step_of(0, radius)
        for k in range(weights.shape[0] // size):
            for sign in ti.static((1, -1)):
                if inside(x + sign * step[0], y + sign * step[1], height, width):
                    away = sign * (step[1] * width + step[0])
                    weight = weights[k * size + p + ti.min(away, 0)]
                    for s in ti.static(range(_SLICES)):
                        sums[s] += weight * volume[slices[s] + away]
            step = step_after(step, radius)
        for s in ti.static(range(_SLICES)):
            if first + s < last:
                average_out[slices[s]] = sums[s] / totals[p]


@operation
@ti.kernel
def add_reduced(
    reduced: flat(),
    shares: flat(),
    weight: float,
    height: int,
    width: int,
    volume_inout: flat(),
):
    size = height * width
    rows = height // REDUCTION
    columns = width // REDUCTION
    for p in range(volume_inout.shape[0]):
        y = ti.math.clamp((p % size // width + 0.5) / REDUCTION - 0.5, 0.0, rows - 1.0)
        x = ti.math.clamp((p % width + 0.5) / REDUCTION - 0.5, 0.0, columns - 1.0)
        row = int(y)
        column = int(x)
        here = row * columns + column
        right = ti.min(1, columns - 1 - column)
        down = ti.min(1, rows - 1 - row) * columns
        first = p // size * rows * columns + here
        above = shares[here] * reduced[first]
        above += (x - column) * (shares[here + right] * reduced[first + right] - above)
        below = shares[here + down] * reduced[first + down]
        below += (x - column) * (shares[here + down + right] * reduced[first + down + right] - below)
        volume_inout[p] += weight * (above + (y - row) * (below - above))


@operation
@ti.kernel
def least_costs(volume: flat(), least_out: flat()):
    size = least_out.shape[0]
    for p in range(size):
        least = volume[p]
        for s in range(1, volume.shape[0] // size):
            least = ti.min(least, volume[s * size + p])
        least_out[p] = least


@operation
@ti.kernel
def winner_takes_all(volume: flat(), first: float, step: float, disparity_out: flat()):
    size = disparity_out.shape[0]
    for p in range(size):
        count = volume.shape[0] // size
        k = 0
        least = volume[p]
        for s in range(1, count):
            cost = volume[s * size + p]
            if cost < least:
                least = cost
                k = s
        k = ti.min(ti.max(k, 1), count - 2)
        here = k * size + p
        # Differences first: what the costs have in common has no part in their rounding.
        down = volume[here] - volume[here - size]
        up = volume[here + size] - volume[here]
        t = 0.0
        if up - down > 1e-9:
            t = ti.min(ti.max(-(up + down) / (2.0 * (up - down)), -1.0), 1.0)
        disparity_out[p] = first + step * (ti.cast(k, ti.f32) + t)


def nlm_average(weights: DeviceArray, volume: DeviceArray, *, window: int, average_out: DeviceArray) -> None:
    _, height, width = volume.shape
    totals = scratch(average_out, (height, width))
    run(_total_kernel, weights, height, width, window // 2, totals)
    kernel = _rows_kernel if on_cpu() else _pixels_kernel
    run(kernel, weights, volume, totals, height, width, window // 2, average_out)
