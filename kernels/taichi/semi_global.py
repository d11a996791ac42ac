"""Semi-global matching; `kernels/reference/semi_global.py` says which.

A path has cost nothing before it begins: then the formula of its further pixels gives the first one's costs as they
are. A diagonal that leaves the frame at one side goes on, as another path, at the other side of the next row.
"""

from typing import Any

import taichi as ti

from .memory import DeviceArray, flat, scratch
from .runtime import TASK, most_bytes, on_cpu, once, run

_DIRECTIONS = ((1, -1), (1, 0), (1, 1), (0, 1), (-1, -1), (-1, 0), (-1, 1), (0, -1))  # (dy, dx)
_BLOCK = 32  # paths whose costs lie side by side
_SOME = 8  # disparities of which a thread reads all costs before it goes on
_LANES, _PATHS = 16, 8  # threads of a GPU that follow a path, and paths of a block of threads
_SPARE = 2**29  # bytes: volumes of directions that a GPU follows at the same time, at most


@ti.func
def pixel_of(path: int, i: int, dy: int, dx: int, height: int, width: int):
    """(p, begins): the index of pixel `i` of a path, and whether a path begins there."""
    x = path
    y = path
    if dy == 0:
        x = i
        if dx < 0:
            x = width - 1 - i
    else:
        x = (path + dx * i) % width  # never negative: as Python does it
        y = i
        if dy < 0:
            y = height - 1 - i
    return y * width + x, i == 0 or x - dx < 0 or x - dx >= width


@ti.func
def penalties(color: ti.template(), before: ti.template(), scale: float, small: float, large: float, contrast: float):
    """(one, more): the costs of a step to the next disparity and to any other one, from the pixel before."""
    difference = ti.abs(color - before)
    likeness = ti.exp(-difference.sum() / (difference.n * contrast))
    return scale * small * ti.max(likeness, 0.2), scale * ti.max(large * likeness, 1.2 * small)


@once
def _cpu_kernel(channels: int) -> Any:
    @ti.kernel
    def blocks_kernel(
        volume: flat(),
        image: flat(channels=channels),
        scale: flat(),
        height: int,
        width: int,
        small: float,
        large: float,
        contrast: float,
        dy: int,
        dx: int,
        adds: int,
        paths: int,
        steps: int,
        costs: flat(),
        leasts: flat(),
        sums: flat(),
    ):
        """Follow a block of paths on each thread of a CPU, pixel by pixel, as they lie side by side.

        `costs` [block, l, path] and `leasts` [path] are those of the paths so far.
        """
        size = height * width
        count = volume.shape[0] // size
        for task in range((paths + _BLOCK - 1) // _BLOCK * TASK):
            if task % TASK == 0:
                first = task // TASK * _BLOCK
                for i in range(steps):
                    for path in range(first, ti.min(first + _BLOCK, paths)):
                        p, begins = pixel_of(path, i, dy, dx, height, width)
                        least = 0.0
                        one = 0.0
                        most = 0.0
                        if not begins:
                            least = leasts[path]
                            before_it = image[p - dy * width - dx]
                            one, more = penalties(image[p], before_it, scale[p], small, large, contrast)
                            most = least + more
                        least_here = ti.math.inf
                        low = ti.math.inf
                        start = path // _BLOCK * (count * _BLOCK) + path % _BLOCK
                        for part in range((count + _SOME - 1) // _SOME):
                            label = part * _SOME
                            before = ti.Vector([0.0 for _ in range(_SOME + 1)])
                            cost = ti.Vector([0.0 for _ in range(_SOME)])
                            total = ti.Vector([0.0 for _ in range(_SOME)])
                            for k in ti.static(range(_SOME + 1)):
                                if label + k >= count:
                                    before[k] = ti.math.inf
                                elif not begins:
                                    before[k] = costs[start + (label + k) * _BLOCK]
                            for k in ti.static(range(_SOME)):
                                place = ti.min(label + k, count - 1) * size + p
                                cost[k] = volume[place]
                                if adds != 0:
                                    total[k] = sums[place]
                            for k in ti.static(range(_SOME)):
                                change = ti.min(ti.min(low, before[k + 1]) + one, most)
                                cost[k] += ti.min(before[k], change) - least
                                low = before[k]
                            for k in ti.static(range(_SOME)):
                                if label + k < count:
                                    least_here = ti.min(least_here, cost[k])
                                    costs[start + (label + k) * _BLOCK] = cost[k]
                                    sums[(label + k) * size + p] = total[k] + cost[k]
                        leasts[path] = least_here

    return blocks_kernel


@ti.func
def direction_of(k: int):
    """(dy, dx) of `_DIRECTIONS[k]`."""
    ahead = 1 - k // 4 * 2
    dy = ahead
    dx = k % 4 - 1
    if k % 4 == 3:
        dy = 0
        dx = ahead
    return dy, dx


@once
def _gpu_kernel(channels: int, some: int) -> Any:
    """Return the kernel in which a row of threads follows a path, with `some` disparities each."""
    room = _LANES * some + 2  # costs of a path, with one more at either end

    @ti.kernel
    def lanes_kernel(
        volume: flat(),
        image: flat(channels=channels),
        scale: flat(),
        height: int,
        width: int,
        small: float,
        large: float,
        contrast: float,
        begin: int,
        end: int,
        others: flat(),
        sums: flat(),
    ):
        """Follow paths of the directions from `begin` to `end`, all but the first with a volume of its own.

        Keep the costs of two steps, of which one is read and one is written, so that threads meet once a step.
        """
        blocks = (ti.max(height, width) + _PATHS - 1) // _PATHS
        many = ti.select(end - begin > 1, volume.shape[0], 0)
        ti.loop_config(block_dim=_LANES * _PATHS)
        for thread in range((end - begin) * blocks * _PATHS * _LANES):
            costs = ti.simt.block.SharedArray((2 * room * _PATHS,), ti.f32)
            leasts = ti.simt.block.SharedArray((2 * _LANES * _PATHS,), ti.f32)
            size = height * width
            count = volume.shape[0] // size
            own = thread % _PATHS
            lane = thread // _PATHS % _LANES
            block = thread // (_PATHS * _LANES)
            direction = begin + block // blocks
            dy, dx = direction_of(direction)
            paths = ti.select(dy == 0, height, width)
            steps = ti.select(dy == 0, width, height)
            path = ti.min(block % blocks * _PATHS + own, paths - 1)  # the last one several times
            counts = block % blocks * _PATHS + own < paths
            is_first = direction == begin
            adds = is_first and begin > 0
            beyond = (direction - begin - 1) * volume.shape[0]
            first = lane * some
            for side in range(2):
                if lane == 0:
                    costs[(side * room) * _PATHS + own] = ti.math.inf
                    costs[(side * room + room - 1) * _PATHS + own] = ti.math.inf
            cost = ti.Vector([0.0 for _ in range(some)])
            total = ti.Vector([0.0 for _ in range(some)])
            p, begins = pixel_of(path, 0, dy, dx, height, width)
            color = image[p]
            last_color = color
            factor = scale[p]
            for k in ti.static(range(some)):
                place = ti.min(first + k, count - 1) * size + p
                cost[k] = volume[place]
                if adds:
                    total[k] = sums[place]
            for i in range(steps):
                # What the next step needs is on its way while this one is worked out.
                next_p, next_begins = pixel_of(path, ti.min(i + 1, steps - 1), dy, dx, height, width)
                next_color = image[next_p]
                next_factor = scale[next_p]
                next_cost = ti.Vector([0.0 for _ in range(some)])
                next_total = ti.Vector([0.0 for _ in range(some)])
                for k in ti.static(range(some)):
                    place = ti.min(first + k, count - 1) * size + next_p
                    next_cost[k] = volume[place]
                    if adds:
                        next_total[k] = sums[place]
                side = i % 2
                if not begins:
                    least = ti.math.inf
                    for k in ti.static(range(_LANES)):
                        least = ti.min(least, leasts[((1 - side) * _LANES + k) * _PATHS + own])
                    one, more = penalties(color, last_color, factor, small, large, contrast)
                    before = ti.Vector([0.0 for _ in range(some + 2)])
                    for k in ti.static(range(some + 2)):
                        before[k] = costs[((1 - side) * room + first + k) * _PATHS + own]
                    for k in ti.static(range(some)):
                        change = ti.min(ti.min(before[k], before[k + 2]) + one, least + more)
                        cost[k] += ti.min(before[k + 1], change) - least
                least_here = ti.math.inf
                for k in ti.static(range(some)):
                    kept = ti.select(first + k < count, cost[k], ti.math.inf)
                    costs[(side * room + first + 1 + k) * _PATHS + own] = kept
                    least_here = ti.min(least_here, kept)
                    if counts and first + k < count:
                        place = (first + k) * size + p
                        if is_first:
                            sums[place] = total[k] + cost[k]
                        else:
                            others[beyond + place] = cost[k]
                leasts[(side * _LANES + lane) * _PATHS + own] = least_here
                ti.simt.block.sync()
                last_color = color
                color = next_color
                factor = next_factor
                cost = next_cost
                total = next_total
                p = next_p
                begins = next_begins
        for i in range(many):
            total = sums[i]
            for k in range(end - begin - 1):
                total += others[k * volume.shape[0] + i]
            sums[i] = total

    return lanes_kernel


def semi_global(
    volume: DeviceArray,
    image: DeviceArray,
    penalty_scale: DeviceArray,
    *,
    small: float,
    large: float,
    contrast: float,
    sum_out: DeviceArray,
) -> None:
    count, height, width = volume.shape
    inputs = volume, image, penalty_scale, height, width, small, large, contrast
    if not on_cpu():
        spare = min(len(_DIRECTIONS) - 1, min(_SPARE, most_bytes()) // (4 * volume.size))
        others = scratch(sum_out, (max(1, spare * volume.size),))
        kernel, at_once = _gpu_kernel(image.channels, -(-count // _LANES)), 1 + spare
        for begin in range(0, len(_DIRECTIONS), at_once):
            end = min(begin + at_once, len(_DIRECTIONS))
            run(kernel, *inputs, begin, end, others, sum_out)
        return
    kernel, blocks = _cpu_kernel(image.channels), -(-max(height, width) // _BLOCK)
    costs, leasts = scratch(sum_out, (blocks, count, _BLOCK)), scratch(sum_out, (blocks, _BLOCK))
    for k, (dy, dx) in enumerate(_DIRECTIONS):
        paths, steps = (width, height) if dy else (height, width)
        run(kernel, *inputs, dy, dx, int(k > 0), paths, steps, costs, leasts, sum_out)
