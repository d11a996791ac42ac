"""Costs by angular sector; `kernels/reference/sectors.py` says what they are."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from lfgpu.contract import COST_UNIT, COSTS, FOLD, SECTORS, Rows, sectors_of

from .memory import DeviceArray, flat, numpy, optional, table
from .runtime import double, once, run
from .sums import BLOCK, PARTS, parts, share, summing

_NO_COSTS = 1.0  # where no view takes part


@ti.func
def place_of(c: int, y: int, x: int, columns: int, channels: int):
    """Find the place of channel c of the pixel (y, x) in a folded image."""
    pixel = y // FOLD * columns + x // FOLD
    return pixel * channels * FOLD * FOLD + c * FOLD * FOLD + y % FOLD * FOLD + x % FOLD


@ti.func
def cost_of(difference: float):
    return 0.25 * ti.log(1.0 + difference / COST_UNIT)


@once
def _costs_kernel(channels: int, stored: Any, costs: Any, masked: bool) -> Any:
    @ti.kernel
    def costs_kernel(
        views: flat(stored, channels),
        image: flat(channels=channels),
        valid: flat(),
        order: flat(),
        begins: flat(),
        first: flat(),
        factor: flat(double()),
        scale: float,
        step: float,
        top: int,
        some: int,
        height: int,
        width: int,
        slices: int,
        rows: int,
        columns: int,
        costs_out: flat(costs),
    ):
        """`order` holds for each view its number and its offset."""
        gain = ti.cast(factor[0], ti.f32)
        size = some * columns * FOLD * FOLD
        for i in range(slices * size):
            slice_ = i // size
            begin = slice_ * COSTS * rows * columns * FOLD * FOLD
            line = top * FOLD + i % size // (columns * FOLD)
            fy = line % (rows * FOLD)
            fx = i % (columns * FOLD)
            y = ti.min(line, height - 1)
            x = ti.min(fx, width - 1)
            here = y * width + x
            disparity = first[here] + ti.cast(slice_, ti.f32) * step
            reference = gain * image[here]
            sums = ti.Vector([0.0, 0.0])
            there = 0
            count = 0.0
            for s in range(SECTORS):
                single = 0.0
                common = ti.Vector([0.0 for _ in range(channels)])
                seen = 0.0
                for k in range(ti.cast(begins[s], ti.i32), ti.cast(begins[s + 1], ti.i32)):
                    # The whole pixels of a shift and the rest apart: their sum with a column would have fewer digits.
                    right = -disparity * order[3 * k + 1]
                    down = -disparity * order[3 * k + 2]
                    dx = ti.floor(right)
                    dy = ti.floor(down)
                    ax = right - dx
                    ay = down - dy
                    beside = ti.cast(ax > 0.0, ti.i32)
                    below = ti.cast(ay > 0.0, ti.i32)
                    tx = x + ti.cast(ti.math.clamp(dx, -2.0 * width, 2.0 * width), ti.i32)
                    ty = y + ti.cast(ti.math.clamp(dy, -2.0 * height, 2.0 * height), ti.i32)
                    inside = tx >= 0 and tx + beside < width and ty >= 0 and ty + below < height
                    view = ti.cast(order[3 * k], ti.i32) * height
                    if inside:
                        if ti.static(masked):
                            near = (view + ty + ti.cast(ay >= 0.5, ti.i32)) * width + tx + ti.cast(ax >= 0.5, ti.i32)
                            inside = valid[near] != 0.0
                    if inside:
                        upper = (view + ty) * width + tx
                        lower = upper + below * width
                        high = ti.cast(views[upper], ti.f32)
                        high += ax * (ti.cast(views[upper + beside], ti.f32) - high)
                        low = ti.cast(views[lower], ti.f32)
                        low += ax * (ti.cast(views[lower + beside], ti.f32) - low)
                        difference = gain * scale * (high + ay * (low - high)) - reference
                        single += abs(difference).sum()
                        common += difference
                        seen += 1.0
                if seen > 0.0:
                    one = cost_of(single / (channels * seen))
                    all_ = cost_of(abs(common).sum() / (channels * seen))
                    costs_out[begin + place_of(s, fy, fx, columns, COSTS)] = ti.cast(one, costs)
                    costs_out[begin + place_of(SECTORS + s, fy, fx, columns, COSTS)] = ti.cast(all_, costs)
                    sums += ti.Vector([one, all_])
                    there |= 1 << s
                    count += 1.0
            for s in range(SECTORS):
                if (there >> s) & 1 == 0:
                    for k in ti.static(range(2)):
                        cost = ti.select(count > 0.0, sums[k] / ti.max(count, 1.0), _NO_COSTS)
                        c = k * SECTORS + s
                        costs_out[begin + place_of(c, fy, fx, columns, COSTS)] = ti.cast(cost, costs)

    return costs_kernel


class sector_costs:
    """The views in the order of their sectors."""

    def __init__(self, shape: Sequence[int], offsets: DeviceArray, *, scale: float) -> None:
        self._shape, self._scale = tuple(shape), scale
        places = numpy(offsets)
        sectors = sectors_of(places)
        order = np.argsort(sectors, kind="stable")[np.count_nonzero(sectors < 0) :]
        self._order = table(np.concatenate([order[:, None], places[order]], axis=1))
        self._begins = table(np.searchsorted(sectors[order], np.arange(SECTORS + 1)))

    def load(self, image: DeviceArray, recorded: DeviceArray, valid: DeviceArray | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid

    def __call__(
        self,
        first: DeviceArray,
        factor: DeviceArray,
        costs_out: DeviceArray,
        *,
        step: float,
        rows: Rows | None = None,
    ) -> None:
        _, height, width, channels = self._shape
        mask, masked = optional(self._valid)
        find = _costs_kernel(channels, self._recorded.scalar, costs_out.scalar, masked)
        arrays = self._recorded, self._image, mask, self._order, self._begins, first, factor
        place = (0, costs_out.shape[1]) if rows is None else (rows.first, rows.last - rows.first)
        run(find, *arrays, self._scale, step, *place, height, width, *costs_out.shape, costs_out)


@once
def _brightness_kernel(channels: int) -> Any:
    real, sums = double(), summing()

    @ti.kernel
    def brightness_kernel(image: flat(channels=channels), parts: flat(real), factor_out: flat(real)):
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.turns):
            i, step, end = share(turn, sums.turns, image.shape[0], sums.cpu)
            term = ti.cast(0.0, real)
            while i < end:
                term += ti.cast(image[i].sum(), real)
                i += step
            sums.keep(term, turn, parts)
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.threads):
            total = sums.total(parts, 0, PARTS, turn)
            if turn == 0:
                factor_out[0] = ti.math.clamp(0.4 / (total / (image.shape[0] * channels) + 0.08), 0.5, 4.0)

    return brightness_kernel


def brightness(image: DeviceArray, *, factor_out: DeviceArray) -> None:
    run(_brightness_kernel(image.channels or 1), image, parts(), factor_out)


@once
def _fold_kernel(channels: int, stored: Any) -> Any:
    @ti.kernel
    def fold_kernel(
        image: flat(channels=channels),
        factor: flat(double()),
        height: int,
        width: int,
        rows: int,
        columns: int,
        folded_out: flat(stored),
    ):
        gain = ti.cast(factor[0], ti.f32)
        for i in range(rows * columns * FOLD * FOLD):
            x = i % (FOLD * columns)
            y = i // (FOLD * columns)
            color = gain * image[ti.min(y, height - 1) * width + ti.min(x, width - 1)]
            for c in ti.static(range(4)):
                value = 0.0
                if ti.static(c < 3):
                    value = color[min(c, channels - 1)]
                folded_out[place_of(c, y, x, columns, 4)] = ti.cast(value, stored)

    return fold_kernel


def fold(image: DeviceArray, factor: DeviceArray, *, folded_out: DeviceArray) -> None:
    folding = _fold_kernel(image.channels, folded_out.scalar)
    run(folding, image, factor, *image.shape, *folded_out.shape[1:], folded_out)
