"""Views compared at a low resolution, to find which disparities there are: see `RangeSearch` in `lfgpu/contract`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from lfgpu.contract import UNSEEN, Details, Disparities, SideCosts, sweep_shifts

from .memory import DeviceArray, empty, flat, indices, operation, optional, upload
from .plane_sweep import shift_of, within
from .runtime import double, once, run, start


@once
def _shrink_kernel(channels: int, stored: Any, masked: bool) -> Any:
    @ti.kernel
    def shrink_kernel(
        views: flat(stored, channels),
        chosen: flat(ti.i32),
        valid: flat(),
        scale: float,
        factor: int,
        full_height: int,
        full_width: int,
        images_out: flat(),
    ):
        height = full_height // factor
        width = full_width // factor
        for p in range(images_out.shape[0]):
            x = p % width
            y = p // width % height
            k = p // width // height
            total = 0.0
            known = True
            for i in range(factor * factor):
                at = (y * factor + i // factor) * full_width + x * factor + i % factor
                value = ti.cast(views[chosen[k] * full_height * full_width + at], ti.f32)
                for c in ti.static(range(channels)):
                    total += value[c]
                if ti.static(masked):
                    known = known and valid[k * full_height * full_width + at] != 0.0
            images_out[p] = ti.select(known, scale * total / ti.cast(factor * factor * channels, ti.f32), ti.math.nan)

    return shrink_kernel


@ti.kernel
def _shrink_again_kernel(images: flat(), height: int, width: int, factor: int, smaller_out: flat()):
    """Images of `height` and `width` become smaller by a factor; NaN stays."""
    columns = width // factor
    rows = height // factor
    for p in range(smaller_out.shape[0]):
        first = (p // columns // rows * height + p // columns % rows * factor) * width + p % columns * factor
        total = 0.0
        for i in range(factor * factor):
            total += images[first + i // factor * width + i % factor]
        smaller_out[p] = total / ti.cast(factor * factor, ti.f32)


@ti.kernel
def _window_kernel(values: flat(), width: int, radius: int, sums_out: flat(), parts_out: flat()):
    """Sums along the rows of what is not NaN, and how many pixels they are of."""
    for p in range(sums_out.shape[0]):
        x = p % width
        total = 0.0
        parts = 0.0
        for k in range(-radius, radius + 1):
            value = values[p - x + within(x + k, width)]
            if value == value:
                total += value
                parts += 1.0
        sums_out[p] = total
        parts_out[p] = parts


@ti.kernel
def _details_kernel(
    images: flat(), sums: flat(), parts: flat(), height: int, width: int, radius: int, details_out: flat()
):
    """Sums down the columns, and what their mean leaves."""
    for p in range(details_out.shape[0]):
        y = p // width % height
        total = 0.0
        count = 0.0
        for k in range(-radius, radius + 1):
            at = p + (within(y + k, height) - y) * width
            total += sums[at]
            count += parts[at]
        details_out[p] = images[p] - total / ti.max(count, 1.0)


def shrink(
    views: DeviceArray,
    chosen: Sequence[int],
    valid: DeviceArray | None,
    *,
    scale: float,
    factor: int,
    images_out: DeviceArray,
) -> None:
    kernel = _shrink_kernel(views.channels, views.scalar, valid is not None)
    line, (mask, _) = indices(tuple(int(index) for index in chosen)), optional(valid)
    run(kernel, views, line, mask, scale, factor, *views.shape[1:], images_out)


def details(shape: Sequence[int], device: str, *, factor: int, window: int) -> Details:
    start(device)
    n, height, width = shape[0], shape[1] // factor, shape[2] // factor
    smaller, sums, parts = (empty((n, height, width)) for _ in range(3))

    def evaluate(images: DeviceArray, details_out: DeviceArray) -> None:
        run(_shrink_again_kernel, images, shape[1], shape[2], factor, smaller)
        run(_window_kernel, smaller, width, window // 2, sums, parts)
        run(_details_kernel, smaller, sums, parts, height, width, window // 2, details_out)

    return evaluate


@ti.kernel
def _differences_kernel(
    details: flat(),
    reference: int,
    shifts: flat(),
    begin: int,
    end: int,
    views: int,
    height: int,
    width: int,
    sums_out: flat(),
    parts_out: flat(),
):
    """Differences of the views from `begin` to before `end` at each disparity: sums, and how many they are."""
    size = height * width
    for i in range(sums_out.shape[0]):
        label = i // size
        p = i - label * size
        x = p % width
        y = p // width
        total = 0.0
        parts = 0.0
        for k in range(begin, end):
            shift = shift_of(shifts, label * views + k)
            right = ti.cast(shift.ax > 0.0, ti.i32)
            down = ti.cast(shift.ay > 0.0, ti.i32) * width
            qx = x + shift.x
            qy = y + shift.y
            if qx >= 0 and qx + right < width and qy >= 0 and qy * width + down < size:
                at = shift.view * size + qy * width + qx
                # What has no share is not looked at: it may be unknown.
                above = details[at] + shift.ax * (details[at + right] - details[at])
                below = details[at + down] + shift.ax * (details[at + down + right] - details[at + down])
                difference = ti.abs(above + shift.ay * (below - above) - details[reference * size + p])
                if difference == difference:
                    total += difference
                    parts += 1.0
        sums_out[i] = total
        parts_out[i] = parts


@ti.kernel
def _costs_kernel(
    sums: flat(), parts: flat(), height: int, width: int, needed: float, first: int, is_first: int, volume_out: flat()
):
    """Means over 3 x 3 pixels, or what was there if that is less; `first` is where their line begins."""
    for i in range(sums.shape[0]):
        x = i % width
        y = i // width % height
        total = 0.0
        count = 0.0
        for k in range(9):
            dx = k % 3 - 1
            dy = k // 3 - 1
            if x + dx >= 0 and x + dx < width and y + dy >= 0 and y + dy < height:
                total += sums[i + dy * width + dx]
                count += parts[i + dy * width + dx]
        cost = UNSEEN
        if count >= needed:
            cost = total / ti.max(count, 1.0)
        if is_first == 0:
            cost = ti.min(cost, volume_out[first + i])
        volume_out[first + i] = cost


def side_costs(
    shape: Sequence[int],
    offsets: NDArray[Any],
    lines: Sequence[Sequence[Sequence[int]]],
    device: str,
    *,
    reference: int,
    count: int,
) -> SideCosts:
    start(device)
    _, height, width = shape
    views = np.concatenate([np.asarray(side, np.int64) for line in lines for side in line])
    places = np.broadcast_to(views, (count, len(views)))[..., None]
    shifts = empty((count, len(views), 5))
    sums, parts = (empty((count, height, width)) for _ in range(2))

    def evaluate(details: DeviceArray, first: float, step: float, volume_out: DeviceArray) -> None:
        chosen = sweep_shifts(offsets, Disparities(first, step, count))[:, views]
        whole, begin = np.floor(chosen), 0
        upload(np.concatenate([places, whole, chosen - whole], 2), shifts)
        for m, line in enumerate(lines):
            for k, side in enumerate(line):
                end = begin + len(side)
                compared = reference, shifts, begin, end, len(views), height, width
                run(_differences_kernel, details, *compared, sums, parts)
                place = m * count * height * width
                share = height, width, 4.5 * len(side), place, int(k == 0)
                run(_costs_kernel, sums, parts, *share, volume_out)
                begin = end

    return evaluate


@ti.func
def _mean(volume: ti.template(), lines: int, at: int, stride: int):
    total = 0.0
    for i in range(lines):
        total += ti.min(volume[at + i * stride], 1.0)
    return total / ti.cast(lines, ti.f32)


@ti.kernel
def _distinct_kernel(
    volume: flat(),
    lines: int,
    count: int,
    apart: int,
    size: int,
    place_out: flat(),
    least_out: flat(),
    spread_out: flat(),
    others_out: flat(),
    worst_out: flat(),
):
    for p in range(size):
        stride = count * size
        k = 0
        least = _mean(volume, lines, p, stride)
        most = least
        for s in range(1, count):
            cost = _mean(volume, lines, s * size + p, stride)
            if cost < least:
                least = cost
                k = s
            most = ti.max(most, cost)
        others = UNSEEN
        for s in range(count):
            if ti.abs(s - k) > apart:
                others = ti.min(others, _mean(volume, lines, s * size + p, stride))
        t = 0.0
        worst = UNSEEN
        if k > 0 and k < count - 1:
            down = least - _mean(volume, lines, (k - 1) * size + p, stride)
            up = _mean(volume, lines, (k + 1) * size + p, stride) - least
            if up - down > 1e-9:
                t = ti.min(ti.max(-(up + down) / (2.0 * (up - down)), -1.0), 1.0)
            worst = 0.0
            for i in range(lines):
                worst = ti.max(worst, volume[k * size + p + i * stride])
        place_out[p] = ti.cast(k, ti.f32) + t
        least_out[p] = least
        spread_out[p] = ti.select(least < 1.0, most - least, ti.math.nan)
        others_out[p] = ti.select(others < UNSEEN, others - least, UNSEEN)
        worst_out[p] = worst


def distinct_minimum(volume: DeviceArray, *, apart: int, found_out: Sequence[DeviceArray]) -> None:
    lines, count, height, width = volume.shape
    run(_distinct_kernel, volume, lines, count, apart, height * width, *found_out)


@once
def _agreeing_kernel() -> Any:
    real = double()

    @ti.kernel
    def agreeing_kernel(
        place: flat(),
        others: flat(),
        worst: flat(),
        noise: flat(real),
        least_noise: real,
        same: real,
        other: real,
        neighbors: int,
        first: float,
        step: float,
        width: int,
        disparity_out: flat(),
    ):
        for p in range(disparity_out.shape[0]):
            s = noise[0]
            if not s > least_noise:
                s = least_noise
            most = ti.cast(ti.min(s * same, 1.0), ti.f32)
            least = ti.cast(s * other, ti.f32)
            total = 0.0
            count = 0
            if worst[p] <= most and others[p] >= least:
                here = first + step * place[p]
                for i in range(9):
                    y = p // width + i // 3 - 1
                    x = p % width + i % 3 - 1
                    q = y * width + x
                    if x >= 0 and x < width and q >= 0 and q < disparity_out.shape[0]:
                        there = first + step * place[q]
                        if worst[q] <= most and others[q] >= least and ti.abs(there - here) <= 1.5 * step:
                            total += there
                            count += 1
            disparity_out[p] = ti.select(count > neighbors, total / ti.max(count, 1), ti.math.nan)

    return agreeing_kernel


_find_agreeing = operation(_agreeing_kernel)


def agreeing_disparity(found: Sequence[DeviceArray], noise: DeviceArray, **given: Any) -> None:
    place, _, _, others, worst = found
    _find_agreeing(place, others, worst, noise, **given)
