"""Matching costs of the views at a row of disparities.

`PlaneSweep` in `lfgpu/contract` says what is computed. On a CPU one disparity after the other, some views at a time:
first their differences from the reference view, then the costs of these. On a GPU in one launch, with a thread for each
pixel and disparity, whose sums stay in registers. Views that belong to the same view_sets are added up first, and then
once to each of these.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import taichi as ti

from lfgpu.contract import Disparities, SweepCost, ViewSets, sweep_shifts

from .memory import DeviceArray, empty, flat, numpy, optional, table
from .runtime import on_cpu, once, run

_LEAST_OFFSET = 1e-3  # view steps; what is nearer to the reference view is the reference view
_PENALTY = 1e-4  # of all view_sets but the first, besides their preference
_TOGETHER = 4  # views at a time on a CPU, so that what lies between two kernels stays in a cache
_BLOCK = 64  # pixels of a row at a time on a CPU, so that what they share is worked out once


@ti.dataclass
class Shift:
    """By how much all pixels of a view are shifted: whole pixels, and the rest of [0, 1)."""

    view: ti.i32
    x: ti.i32
    y: ti.i32
    ax: ti.f32
    ay: ti.f32


@ti.func
def shift_of(shifts: ti.template(), i: int):
    return Shift(
        view=ti.cast(shifts[5 * i], ti.i32),
        x=ti.cast(shifts[5 * i + 1], ti.i32),
        y=ti.cast(shifts[5 * i + 2], ti.i32),
        ax=ti.cast(shifts[5 * i + 3], ti.f32),
        ay=ti.cast(shifts[5 * i + 4], ti.f32),
    )


@ti.func
def within(i: int, size: int):
    return ti.min(ti.max(i, 0), size - 1)


@ti.func
def rooted(difference: float, softness: float):
    """Keep a difference while it is small; beyond the softness take its root."""
    result = difference
    if softness > 0.0:
        # 2 s (sqrt(1 + x / s) - 1), without the difference of two nearly equal numbers
        result = 2.0 * difference / (ti.sqrt(1.0 + difference / softness) + 1.0)
    return result


def _planes_of(channels: int, stored: Any) -> tuple[int, int, Any]:
    """(channels of a plane, planes, type): a GPU reads channels of 8 and 16 bits together, as words of 32 bits."""
    together = 1 if on_cpu() else min({ti.u8: 4, ti.u16: 2}.get(stored, 1), channels)
    return together, -(-channels // together), stored if together == 1 else ti.u32


@once
def _planes_kernel(channels: int, stored: Any) -> Any:
    together, planes, scalar = _planes_of(channels, stored)

    @ti.kernel
    def planes_kernel(images: flat(stored, channels), size: int, planes_out: flat(scalar)):
        """Images of `size` pixels, plane by plane."""
        for i in range(images.shape[0]):
            n = i // size
            for m in ti.static(range(planes)):
                value = ti.cast(images[i][m * together], scalar)
                for c in ti.static(range(m * together + 1, min((m + 1) * together, channels))):
                    value |= ti.cast(images[i][c], scalar) << (32 // together * (c - m * together))
                planes_out[(n * planes + m) * size + i - n * size] = value

    return planes_kernel


@once
def _difference_kernel(stored: Any, block: int) -> Any:
    """Compute `block` pixels that lie one after the other on each thread."""

    @ti.kernel
    def difference_kernel(
        views: flat(stored),
        image: flat(),
        shifts: flat(),
        first: int,
        count: int,
        channels: int,
        height: int,
        width: int,
        scale: float,
        differences_out: flat(),
    ):
        """W_n - I of the `count` shifted views from `first` on, channel by channel."""
        blocks = (width + block - 1) // block
        for i in range(count * channels * height * blocks):
            row = i // blocks
            begin = (i - row * blocks) * block
            plane = row // height
            y = row - plane * height
            k = plane // channels
            c = plane - k * channels
            shift = shift_of(shifts, first + k)
            plane = shift.view * channels + c
            upper = (plane * height + within(y + shift.y, height)) * width
            lower = (plane * height + within(y + shift.y + 1, height)) * width
            here = (c * height + y) * width
            for x in range(begin, ti.min(begin + block, width)):
                x0 = within(x + shift.x, width)
                x1 = within(x + shift.x + 1, width)
                u = ti.cast(views[upper + x0], ti.f32)
                u += shift.ax * (ti.cast(views[upper + x1], ti.f32) - u)
                d = ti.cast(views[lower + x0], ti.f32)
                d += shift.ax * (ti.cast(views[lower + x1], ti.f32) - d)
                differences_out[row * width + x] = scale * (u + shift.ay * (d - u)) - image[here + x]

    return difference_kernel


@once
def _cost_kernel(channels: int, masked: bool, seen: bool, sloped: bool, block: int) -> Any:
    """Compute `block` pixels that lie one after the other on each thread."""

    @ti.kernel
    def cost_kernel(
        differences: flat(),
        valid: flat(),
        nearest: flat(),
        shifts: flat(),
        members: flat(),
        view_sets: int,
        first: int,
        begin: int,
        end: int,
        height: int,
        width: int,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        softness: float,
        deepest: float,
        group_out: flat(),
        sums_out: flat(),
    ):
        """Add the views from `begin` to before `end`, whose shifts lie from `first` on; at 0 begin anew.

        `members` are for each view its view_sets and, last, whether it is the last one of these. What they add up to is
        a cost and a count for each pixel: `group_out` [2, y, x] and `sums_out` [view_sets, 2, y, x]. Of a sweep of what
        is seen, the sums [1, 2, y, x] are those of the views that see the pixel past `nearest`.
        """
        size = height * width
        blocks = (width + block - 1) // block
        for i in range(height * blocks):
            y = i // blocks
            left = (i - y * blocks) * block
            right = ti.min(left + block, width)
            here = y * width
            if begin == 0:
                for m in range(2 * view_sets):
                    for x in range(left, right):
                        sums_out[m * size + here + x] = 0.0
            for x in range(left, right):
                group_out[here + x] = 0.0
                group_out[size + here + x] = 0.0
            for k in range(begin, end):
                shift = shift_of(shifts, first + k)
                # The places in the frame, and what is nearest to them.
                low = ti.max(left, -shift.x)
                high = ti.min(right, width - shift.x - ti.cast(shift.ax > 0.0, ti.i32))
                to = (shift.view * height + y + shift.y + ti.cast(shift.ay >= 0.5, ti.i32)) * width
                to += shift.x + ti.cast(shift.ax >= 0.5, ti.i32)
                if y + shift.y < 0 or y + shift.y + ti.cast(shift.ay > 0.0, ti.i32) >= height:
                    high = low
                # From a channel's difference to those above and below, of which the border is its own.
                plane = (k - begin) * channels * size + here
                over = plane - ti.select(y > 0, width, 0)
                under = plane + ti.select(y + 1 < height, width, 0)
                for x in range(low, high):
                    color = 0.0
                    slope = 0.0
                    before = ti.max(x - 1, 0) - x
                    after = ti.min(x + 1, width - 1) - x
                    for c in ti.static(range(channels)):
                        p = c * size + x
                        color += abs(differences[plane + p])
                        if ti.static(sloped):
                            slope += abs(differences[plane + p + after] - differences[plane + p + before])
                            slope += abs(differences[under + p] - differences[over + p])
                    cost = rooted(ti.min(color / channels, truncation), softness)
                    if ti.static(sloped):
                        cost += gradient_weight * ti.min(slope / (4 * channels), gradient_truncation)
                    part = 1.0
                    if ti.static(masked):
                        part = ti.select(valid[to + x] != 0.0, part, 0.0)
                    if ti.static(seen):
                        part = ti.select(nearest[to + x] <= deepest, part, 0.0)
                    if ti.static(seen):
                        sums_out[here + x] += part * cost
                        sums_out[size + here + x] += part
                    else:
                        group_out[here + x] += part * cost
                        group_out[size + here + x] += part
                if ti.static(not seen):
                    if k + 1 == end or members[k * (view_sets + 1) + view_sets] != 0.0:
                        for m in range(view_sets):
                            if members[k * (view_sets + 1) + m] != 0.0:
                                for x in range(left, right):
                                    sums_out[2 * m * size + here + x] += group_out[here + x]
                                    sums_out[(2 * m + 1) * size + here + x] += group_out[size + here + x]
                        for x in range(left, right):
                            group_out[here + x] = 0.0
                            group_out[size + here + x] = 0.0

    return cost_kernel


@once
def _gpu_kernel(channels: int, stored: Any, masked: bool, seen: bool, sloped: bool, view_sets: int) -> Any:
    together, planes, scalar = _planes_of(channels, stored)
    bits, pixel = 32 // together, ti.types.vector(channels, ti.f32)

    @ti.func
    def color_at(views: ti.template(), place: int, size: int):
        color = pixel(0.0)
        for m in ti.static(range(planes)):
            value = views[place + m * size]
            for c in ti.static(range(m * together, min((m + 1) * together, channels))):
                if ti.static(together == 1):
                    color[c] = ti.cast(value, ti.f32)
                else:
                    color[c] = ti.cast((value >> (bits * (c - m * together))) & ((1 << bits) - 1), ti.f32)
        return color

    @ti.kernel
    def sweep_kernel(
        views: flat(scalar),
        image: flat(),
        valid: flat(),
        nearest: flat(),
        shifts: flat(),
        members: flat(),
        deepest: flat(),
        count: int,
        height: int,
        width: int,
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        softness: float,
        preference: float,
        least: float,
        volume_out: flat(),
    ):
        size = height * width
        for i in range(volume_out.shape[0]):
            label = i // size
            p = i - label * size
            y = p // width
            x = p - y * width
            # What lies beyond the border has no difference of its own: that of the border counts.
            before = ti.max(x - 1, 0)
            after = ti.min(x + 1, width - 1)
            over = ti.max(y - 1, 0)
            under = ti.min(y + 1, height - 1)
            own = pixel(0.0)
            own_across = pixel(0.0)
            own_down = pixel(0.0)
            for c in ti.static(range(channels)):
                own[c] = image[c * size + p]
                if ti.static(sloped):
                    row = c * size + y * width
                    own_across[c] = image[row + after] - image[row + before]
                    own_down[c] = image[c * size + under * width + x] - image[c * size + over * width + x]
            cost_of_group = 0.0
            parts_of_group = 0.0
            costs = ti.Vector([0.0 for _ in range(view_sets)])
            parts = ti.Vector([0.0 for _ in range(view_sets)])
            for k in range(count):
                shift = shift_of(shifts, label * count + k)
                tx = x + shift.x
                ty = y + shift.y
                part = 0.0
                if tx >= 0 and tx + ti.cast(shift.ax > 0.0, ti.i32) < width:
                    if ty >= 0 and ty + ti.cast(shift.ay > 0.0, ti.i32) < height:
                        part = 1.0
                if part > 0.0:
                    near = (shift.view * height + ty + ti.cast(shift.ay >= 0.5, ti.i32)) * width
                    near += tx + ti.cast(shift.ax >= 0.5, ti.i32)
                    if ti.static(masked):
                        part = ti.select(valid[near] != 0.0, part, 0.0)
                    if ti.static(seen):
                        part = ti.select(nearest[near] <= deepest[label], part, 0.0)
                if part > 0.0:
                    # Four columns and four rows of the view: at the border the pixel stands for its neighbour.
                    left = within(before + shift.x, width)
                    x0 = within(tx, width)
                    x1 = within(tx + 1, width)
                    right = within(after + shift.x + 1, width)
                    first = shift.view * planes * size
                    upper = first + within(ty, height) * width
                    lower = first + within(ty + 1, height) * width
                    u0 = color_at(views, upper + x0, size)
                    u1 = color_at(views, upper + x1, size)
                    d0 = color_at(views, lower + x0, size)
                    d1 = color_at(views, lower + x1, size)
                    u = u0 + shift.ax * (u1 - u0)
                    d = d0 + shift.ax * (d1 - d0)
                    color = abs(scale * (u + shift.ay * (d - u)) - own).sum()
                    slope = 0.0
                    if ti.static(sloped):
                        ul = color_at(views, upper + left, size)
                        dl = color_at(views, lower + left, size)
                        ur = color_at(views, upper + right, size)
                        dr = color_at(views, lower + right, size)
                        ul += shift.ax * (ti.select(x > 0, u0, u1) - ul)
                        dl += shift.ax * (ti.select(x > 0, d0, d1) - dl)
                        u1 = ti.select(x + 1 < width, u1, u0)
                        d1 = ti.select(x + 1 < width, d1, d0)
                        ur = u1 + shift.ax * (ur - u1)
                        dr = d1 + shift.ax * (dr - d1)
                        change = ur + shift.ay * (dr - ur) - (ul + shift.ay * (dl - ul))
                        slope += abs(scale * change - own_across).sum()
                        top = first + within(over + shift.y, height) * width
                        bottom = first + within(under + shift.y + 1, height) * width
                        t = color_at(views, top + x0, size)
                        t += shift.ax * (color_at(views, top + x1, size) - t)
                        b = color_at(views, bottom + x0, size)
                        b += shift.ax * (color_at(views, bottom + x1, size) - b)
                        under_it = ti.select(y + 1 < height, d, u)
                        change = under_it + shift.ay * (b - under_it) - (t + shift.ay * (ti.select(y > 0, u, d) - t))
                        slope += abs(scale * change - own_down).sum()
                    cost = rooted(ti.min(color / channels, truncation), softness)
                    if ti.static(sloped):
                        cost += gradient_weight * ti.min(slope / (4 * channels), gradient_truncation)
                    cost_of_group += cost
                    parts_of_group += 1.0
                if ti.static(not seen):
                    if k + 1 == count or members[k * (view_sets + 1) + view_sets] != 0.0:
                        for m in ti.static(range(view_sets)):
                            if members[k * (view_sets + 1) + m] != 0.0:
                                costs[m] += cost_of_group
                                parts[m] += parts_of_group
                        cost_of_group = 0.0
                        parts_of_group = 0.0
            if ti.static(seen):
                costs[0] = cost_of_group
                parts[0] = parts_of_group
            fade = 1.0 / (1.0 + gradient_weight)
            lowest = fade * (rooted(truncation, softness) + gradient_weight * gradient_truncation)
            if parts[0] >= least:
                lowest = fade * costs[0] / parts[0]
            for m in ti.static(range(1, view_sets)):
                if parts[m] > 0.0:
                    lowest = ti.min(lowest, (1.0 + preference) * fade * costs[m] / parts[m] + _PENALTY)
            volume_out[i] = lowest

    return sweep_kernel


@ti.kernel
def _least_kernel(
    sums: flat(),
    view_sets: int,
    truncation: float,
    gradient_weight: float,
    gradient_truncation: float,
    softness: float,
    preference: float,
    least: float,
    first: int,
    size: int,
    volume_out: flat(),
):
    """Write the least mean of the view_sets to the slice of the volume at `first`; the first needs `least`."""
    fade = 1.0 / (1.0 + gradient_weight)
    for p in range(size):
        lowest = fade * (rooted(truncation, softness) + gradient_weight * gradient_truncation)
        if sums[size + p] >= least:
            lowest = fade * sums[p] / sums[size + p]
        for m in range(1, view_sets):
            count = sums[(2 * m + 1) * size + p]
            if count > 0.0:
                mean = fade * sums[2 * m * size + p] / count
                lowest = ti.min(lowest, (1.0 + preference) * mean + _PENALTY)
        volume_out[first + p] = lowest


class plane_sweep:
    """The shifts of the views, in the order of their view sets."""

    def __init__(
        self,
        shape: Sequence[int],
        views: ViewSets,
        disparities: Disparities,
        *,
        scale: float,
        shared: Any = None,
    ) -> None:
        self._shape, self._scale = tuple(shape), scale
        self._preference, self._least = views.preference, float(views.least)
        places, belongs = numpy(views.offsets), numpy(views.members).T != 0
        others = np.flatnonzero(np.hypot(*places.T) > _LEAST_OFFSET)
        others = others[np.lexsort(belongs[others].T)]
        shifts, count = sweep_shifts(places[others], disparities), disparities.count
        whole, members = np.floor(shifts), belongs[others]
        ends = np.any(members != np.roll(members, -1, axis=0), axis=1)
        numbers = np.broadcast_to(others[:, None], (count, len(others), 1))
        self._views, self._view_sets = len(others), belongs.shape[1]
        self._shifts = table(np.concatenate([numbers, whole, shifts - whole], axis=2))
        self._members = table(np.concatenate([members, ends[:, None]], axis=1))
        self._deepest = [float(d) for d in disparities.first + disparities.step * np.arange(count) + views.tolerance]
        _, height, width, channels = self._shape
        self._batch = max(1, min(self._views, _TOGETHER))
        image = empty((channels, height, width)) if shared is None else None
        self._loaded = shared._loaded if shared is not None else SimpleNamespace(image=image, stored=None)
        if on_cpu():
            self._differences = empty((self._batch, channels, height, width))
            self._group = empty((2, height, width))
            self._sums = empty((self._view_sets, 2, height, width))
        else:
            self._limits = table(np.array(self._deepest))

    def room(self, stored: Any) -> int:
        return 0

    def load(self, image: DeviceArray, recorded: DeviceArray, valid: DeviceArray | None, room: Any = None) -> None:
        n, height, width, channels = self._shape
        loaded = self._loaded
        if loaded.stored != recorded.scalar:
            loaded.stored, (_, planes, scalar) = recorded.scalar, _planes_of(channels, recorded.scalar)
            loaded.recorded = empty((n, planes, height, width), scalar=scalar)
        run(_planes_kernel(channels, image.scalar), image, height * width, loaded.image)
        run(_planes_kernel(channels, recorded.scalar), recorded, height * width, loaded.recorded)
        loaded.valid = valid

    def by_view_sets(self, cost: SweepCost, volume_out: DeviceArray) -> None:
        self._sweep(None, self._view_sets, 1.0, cost, volume_out)

    def by_visibility(self, nearest: DeviceArray, cost: SweepCost, volume_out: DeviceArray) -> None:
        self._sweep(nearest, 1, self._least, cost, volume_out)

    def _sweep(
        self,
        nearest: DeviceArray | None,
        sets: int,
        least: float,
        cost: SweepCost,
        volume_out: DeviceArray,
    ) -> None:
        gradients = cost.gradient_weight > 0
        limits = cost.truncation, cost.gradient_weight, cost.gradient_truncation, cost.softness
        loaded, (_, height, width, channels) = self._loaded, self._shape
        (mask, masked), (surface, seen) = optional(loaded.valid), optional(nearest)
        if not on_cpu():
            sweep = _gpu_kernel(channels, loaded.stored, masked, seen, gradients, sets)
            arrays = loaded.recorded, loaded.image, mask, surface, self._shifts, self._members, self._limits
            numbers = self._views, height, width, self._scale, *limits, self._preference, least
            run(sweep, *arrays, *numbers, volume_out)
            return
        differ = _difference_kernel(loaded.recorded.scalar, _BLOCK)
        add = _cost_kernel(channels, masked, seen, gradients, _BLOCK)
        shifts, differences, size = self._shifts, self._differences, height * width
        for label, deepest in enumerate(self._deepest):
            first = label * self._views
            for begin in range(0, max(1, self._views), self._batch):
                end = min(begin + self._batch, self._views)
                these = first + begin, end - begin, channels, height, width, self._scale
                run(differ, loaded.recorded, loaded.image, shifts, *these, differences)
                inputs = differences, mask, surface, shifts, self._members, sets, first, begin, end, height, width
                run(add, *inputs, *limits, deepest, self._group, self._sums)
            place = label * size, size
            run(_least_kernel, self._sums, sets, *limits, self._preference, least, *place, volume_out)
