"""Semi-global matching; `kernels/reference/semi_global.py` says which.

A path has cost nothing before it begins: then the formula of its further pixels gives the first one's costs as they
are. A diagonal that leaves the frame at one side goes on, as another path, at the other side of the next row.
"""

from types import SimpleNamespace

import taichi as ti

from .memory import DeviceArray, empty, flat
from .runtime import TASK, on_cpu, once, run

_DIRECTIONS = ((1, -1), (1, 0), (1, 1), (0, 1), (-1, -1), (-1, 0), (-1, 1), (0, -1))  # (dy, dx)
_BLOCK = 32  # paths whose costs lie side by side
_SOME = 8  # disparities of which a thread reads all costs before it goes on


@once
def _kernels(channels: int) -> SimpleNamespace:
    @ti.func
    def advance(
        volume: ti.template(),
        image: ti.template(),
        scale: ti.template(),
        height: int,
        width: int,
        small: float,
        large: float,
        contrast: float,
        dy: int,
        dx: int,
        adds: int,
        path: int,
        i: int,
        costs: ti.template(),
        leasts: ti.template(),
        sums: ti.template(),
    ):
        """To pixel `i` of a path. `costs` [block, l, path] and `leasts` [path] are those of the path so far."""
        size = height * width
        count = volume.shape[0] // size
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
        p = y * width + x
        begins = i == 0 or x - dx < 0 or x - dx >= width
        least = 0.0
        one = 0.0
        most = 0.0
        if not begins:
            difference = 0.0
            for c in ti.static(range(channels)):
                difference += ti.abs(image[p][c] - image[p - dy * width - dx][c])
            likeness = ti.exp(-difference / (channels * contrast))
            least = leasts[path]
            one = scale[p] * small * ti.max(likeness, 0.2)
            most = least + scale[p] * ti.max(large * likeness, 1.2 * small)
        least_here = ti.math.inf
        low = ti.math.inf
        start = path // _BLOCK * (count * _BLOCK) + path % _BLOCK
        for part in range((count + _SOME - 1) // _SOME):
            first = part * _SOME
            before = ti.Vector([0.0 for _ in range(_SOME + 1)])
            cost = ti.Vector([0.0 for _ in range(_SOME)])
            total = ti.Vector([0.0 for _ in range(_SOME)])
            for k in ti.static(range(_SOME + 1)):
                if first + k >= count:
                    before[k] = ti.math.inf
                elif not begins:
                    before[k] = costs[start + (first + k) * _BLOCK]
            for k in ti.static(range(_SOME)):
                place = ti.min(first + k, count - 1) * size + p
                cost[k] = volume[place]
                if adds != 0:
                    total[k] = sums[place]
            for k in ti.static(range(_SOME)):
                change = ti.min(ti.min(low, before[k + 1]) + one, most)
                cost[k] += ti.min(before[k], change) - least
                low = before[k]
            for k in ti.static(range(_SOME)):
                if first + k < count:
                    least_here = ti.min(least_here, cost[k])
                    costs[start + (first + k) * _BLOCK] = cost[k]
                    sums[(first + k) * size + p] = total[k] + cost[k]
        leasts[path] = least_here

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
        """Follow a block of paths on each thread of a CPU, pixel by pixel, as they lie side by side."""
        for task in range((paths + _BLOCK - 1) // _BLOCK * TASK):
            if task % TASK == 0:
                first = task // TASK * _BLOCK
                for i in range(steps):
                    for path in range(first, ti.min(first + _BLOCK, paths)):
                        advance(
                            volume,
                            image,
                            scale,
                            height,
                            width,
                            small,
                            large,
                            contrast,
                            dy,
                            dx,
                            adds,
                            path,
                            i,
                            costs,
                            leasts,
                            sums,
                        )

    @ti.kernel
    def paths_kernel(
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
        """Follow a path on each thread of a GPU, few on each block, so that all processors have some."""
        ti.loop_config(block_dim=_BLOCK)
        for path in range(paths):
            for i in range(steps):
                advance(
                    volume,
                    image,
                    scale,
                    height,
                    width,
                    small,
                    large,
                    contrast,
                    dy,
                    dx,
                    adds,
                    path,
                    i,
                    costs,
                    leasts,
                    sums,
                )

    return SimpleNamespace(blocks=blocks_kernel, paths=paths_kernel)


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
    most = -(-max(height, width) // _BLOCK)
    costs, leasts = empty((most, count, _BLOCK)), empty((most, _BLOCK))
    kernels = _kernels(image.channels)
    kernel = kernels.blocks if on_cpu() else kernels.paths
    for k, (dy, dx) in enumerate(_DIRECTIONS):
        run(
            kernel,
            volume.values,
            image.values,
            penalty_scale.values,
            height,
            width,
            small,
            large,
            contrast,
            dy,
            dx,
            int(k > 0),
            width if dy else height,
            height if dy else width,
            costs.values,
            leasts.values,
            sum_out.values,
        )
