"""How well the views agree with the reference view at each of a row of disparities.

`PlaneSweep` in `lfgpu/types.py` says what is computed. One disparity after the other, some views at a time: first their
differences from the reference view, then the costs of these. Views that belong to the same apertures are added up
first, and then once to each of these.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from lfgpu.types import PlaneSweep, sweep_shifts

from .memory import DeviceArray, doubles, empty, flat, numpy, optional
from .runtime import on_cpu, once, run

_LEAST_OFFSET = 1e-3  # view steps; what is nearer to the reference view is the reference view
_PENALTY = 1e-4  # of all apertures but the first, besides their preference
_TOGETHER = 32  # views at a time on a GPU, so that there are few launches
_TOGETHER_CPU = 4  # so that what lies between two kernels stays in a cache


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


@once
def _difference_kernel(channels: int, stored: Any) -> Any:
    pixels = flat(channels=channels)

    @ti.func
    def value_of(views: ti.template(), i: int):
        return ti.cast(views[i], ti.f32)

    @ti.kernel
    def difference_kernel(
        views: flat(stored, channels),
        image: pixels,
        shifts: flat(ti.f64),
        first: int,
        count: int,
        height: int,
        width: int,
        scale: float,
        differences_out: pixels,
    ):
        """W_n - I of the `count` shifted views from `first` on."""
        size = height * width
        for i in range(count * size):
            k = i // size
            p = i - k * size
            y = p // width
            x = p - y * width
            shift = shift_of(shifts, first + k)
            x0 = within(x + shift.x, width)
            x1 = within(x + shift.x + 1, width)
            upper = shift.view * size + within(y + shift.y, height) * width
            lower = shift.view * size + within(y + shift.y + 1, height) * width
            left = value_of(views, upper + x0)
            left += shift.ay * (value_of(views, lower + x0) - left)
            right = value_of(views, upper + x1)
            right += shift.ay * (value_of(views, lower + x1) - right)
            differences_out[i] = scale * (left + shift.ax * (right - left)) - image[p]

    return difference_kernel


@once
def _cost_kernel(channels: int, apertures: int, masked: bool, seen: bool) -> Any:
    """Sums of apertures are [2 * apertures, y, x], a cost and a count for each."""

    @ti.kernel
    def cost_kernel(
        differences: flat(channels=channels),
        valid: flat(),
        nearest: flat(),
        shifts: flat(ti.f64),
        members: flat(ti.f64),
        first: int,
        begin: int,
        end: int,
        height: int,
        width: int,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        deepest: float,
        sums_out: flat(),
    ):
        """Add the views from `begin` to before `end`, whose shifts lie from `first` on; at 0 begin anew.

        `members` are for each view its apertures and, last, whether it is the last one of these.
        """
        size = height * width
        for p in range(size):
            y = p // width
            x = p - y * width
            sums = ti.Vector([0.0] * (2 * apertures))
            if begin > 0:
                for m in ti.static(range(apertures)):
                    sums[2 * m] = sums_out[2 * m * size + p]
                    sums[2 * m + 1] = sums_out[(2 * m + 1) * size + p]
            cost = 0.0
            count = 0.0
            for k in range(begin, end):
                shift = shift_of(shifts, first + k)
                beyond_x = x + shift.x + ti.cast(shift.ax > 0.0, ti.i32)
                beyond_y = y + shift.y + ti.cast(shift.ay > 0.0, ti.i32)
                if x + shift.x >= 0 and y + shift.y >= 0 and beyond_x < width and beyond_y < height:
                    near_x = x + shift.x + ti.cast(shift.ax >= 0.5, ti.i32)
                    near_y = y + shift.y + ti.cast(shift.ay >= 0.5, ti.i32)
                    near = shift.view * size + near_y * width + near_x
                    takes_part = True
                    if ti.static(masked):
                        takes_part = valid[near] != 0.0
                    if ti.static(seen):
                        takes_part = takes_part and nearest[near] <= deepest
                    if takes_part:
                        row = (k - begin) * size + y * width
                        along = differences[row + ti.min(x + 1, width - 1)] - differences[row + ti.max(x - 1, 0)]
                        under = (k - begin) * size + ti.min(y + 1, height - 1) * width + x
                        over = (k - begin) * size + ti.max(y - 1, 0) * width + x
                        down = differences[under] - differences[over]
                        color = abs(differences[row + x]).sum() / channels
                        gradient = (abs(along).sum() + abs(down).sum()) / (4 * channels)
                        cost += ti.min(color, truncation) + gradient_weight * ti.min(gradient, gradient_truncation)
                        count += 1.0
                if k + 1 == end or members[k * (apertures + 1) + apertures] != 0.0:
                    for m in ti.static(range(apertures)):
                        if members[k * (apertures + 1) + m] != 0.0:
                            sums[2 * m] += cost
                            sums[2 * m + 1] += count
                    cost = 0.0
                    count = 0.0
            for m in ti.static(range(apertures)):
                sums_out[2 * m * size + p] = sums[2 * m]
                sums_out[(2 * m + 1) * size + p] = sums[2 * m + 1]

    return cost_kernel


@ti.kernel
def _least_kernel(
    sums: flat(),
    apertures: int,
    truncation: float,
    gradient_weight: float,
    gradient_truncation: float,
    preference: float,
    least: float,
    first: int,
    size: int,
    volume_out: flat(),
):
    """The least mean of the apertures, to the slice of the volume that begins at `first`."""
    fade = 1.0 / (1.0 + gradient_weight)
    for p in range(size):
        lowest = fade * (truncation + gradient_weight * gradient_truncation)
        if sums[size + p] >= least:
            lowest = fade * sums[p] / sums[size + p]
        for m in range(1, apertures):
            count = sums[(2 * m + 1) * size + p]
            if count > 0.0:
                mean = fade * sums[2 * m * size + p] / count
                lowest = ti.min(lowest, (1.0 + preference) * mean + _PENALTY)
        volume_out[first + p] = lowest


def _table(values: NDArray[Any]) -> DeviceArray:
    """A copy on the device, of something at least: there is no array of nothing."""
    return doubles(values if values.size else np.zeros(1))


class _PlaneSweep:
    """Which views are shifted by how much, in the order of their apertures."""

    def __init__(
        self,
        shape: Sequence[int],
        offsets: DeviceArray,
        apertures: DeviceArray,
        first: float,
        step: float,
        count: int,
        scale: float,
        limits: tuple[float, float, float],
        preference: float,
        tolerance: float,
        least: int,
    ) -> None:
        self._shape, self._scale, self._limits = tuple(shape), scale, limits
        self._preference, self._least = preference, float(least)
        places, belongs = numpy(offsets), numpy(apertures).T != 0
        others = np.flatnonzero(np.hypot(*places.T) > _LEAST_OFFSET)
        others = others[np.lexsort(belongs[others].T)]
        shifts = sweep_shifts(places[others], first=first, step=step, count=count)
        whole, members = np.floor(shifts), belongs[others]
        ends = np.any(members != np.roll(members, -1, axis=0), axis=1)
        views = np.broadcast_to(others[:, None], (count, len(others), 1))
        self._views, self._apertures = len(others), belongs.shape[1]
        self._shifts = _table(np.concatenate([views, whole, shifts - whole], axis=2))
        self._members = _table(np.concatenate([members, ends[:, None]], axis=1))
        self._together = _table(np.tile([1.0, 0.0], (len(others), 1)))
        self._deepest = [float(d) for d in first + step * np.arange(count) + tolerance]
        _, height, width, channels = self._shape
        self._batch = max(1, min(self._views, _TOGETHER_CPU if on_cpu() else _TOGETHER))
        self._differences = empty((self._batch, height, width), channels=channels)
        self._sums = empty((2 * self._apertures, height, width))

    def load(self, image: DeviceArray, recorded: DeviceArray, valid: DeviceArray | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid

    def apertures(self, volume_out: DeviceArray) -> None:
        self._sweep(None, self._members, self._apertures, 1.0, volume_out)

    def seen(self, nearest: DeviceArray, volume_out: DeviceArray) -> None:
        self._sweep(nearest, self._together, 1, self._least, volume_out)

    def _sweep(
        self,
        nearest: DeviceArray | None,
        members: DeviceArray,
        apertures: int,
        least: float,
        volume_out: DeviceArray,
    ) -> None:
        _, height, width, channels = self._shape
        (mask, masked), (surface, seen), size = optional(self._valid), optional(nearest), height * width
        differ = _difference_kernel(channels, self._recorded.scalar)
        add = _cost_kernel(channels, apertures, masked, seen)
        shifts, differences, sums = self._shifts.values, self._differences.values, self._sums.values
        for label, deepest in enumerate(self._deepest):
            first = label * self._views
            for begin in range(0, max(1, self._views), self._batch):
                end = min(begin + self._batch, self._views)
                images = self._recorded.values, self._image.values
                run(differ, *images, shifts, first + begin, end - begin, height, width, self._scale, differences)
                inputs = differences, mask, surface, shifts, members.values
                run(add, *inputs, first, begin, end, height, width, *self._limits, deepest, sums)
            numbers = *self._limits, self._preference, least, label * size, size
            run(_least_kernel, sums, apertures, *numbers, volume_out.values)


def plane_sweep(
    shape: Sequence[int],
    offsets: DeviceArray,
    apertures: DeviceArray,
    *,
    first: float,
    step: float,
    count: int,
    scale: float,
    truncation: float,
    gradient_weight: float,
    gradient_truncation: float,
    preference: float,
    tolerance: float,
    least: int,
) -> PlaneSweep:
    limits = truncation, gradient_weight, gradient_truncation
    return _PlaneSweep(shape, offsets, apertures, first, step, count, scale, limits, preference, tolerance, least)
