"""The z-buffer of a splat, and which pixels of the reference and of the views see each other.

`kernels/reference/occlusion.py` says what they are. `visible` allocates 4 bytes for each pixel of all views, and gives
them back.
"""

from types import SimpleNamespace

import taichi as ti

from .landing import land, nearest, within
from .memory import DeviceArray, empty, flat, optional
from .runtime import TASK, on_cpu, once, run
from .tent import foot

LEAST_WEIGHT = 1e-20
NOWHERE = -3e38  # the disparity of what is not there
_ANY_SOFTNESS = 0.5  # whatever it is, the same pixels are reached


@ti.func
def sides(a: float, first: int, size: int, softness: float):
    """What a pixel `a` beyond `first` gives to the row or column `first` and to the next one; 0 outside the frame."""
    before = foot(1.0 - a, softness)
    after = foot(a, softness)
    if first < 0 or first >= size:
        before = 0.0
    if first < -1 or first >= size - 1:
        after = 0.0
    return ti.Vector([before, after])


@once
def z_kernels(cpu: bool) -> SimpleNamespace:
    """The z-buffer and what is made of it alone."""
    field = flat()

    @ti.func
    def raise_near(
        disparity: ti.template(),
        offsets: ti.template(),
        n: int,
        p: int,
        height: int,
        width: int,
        softness: float,
        first: int,
        nearest: ti.template(),
    ):
        d = disparity[p]
        to = land(p % width, p // width, d, offsets[2 * n], offsets[2 * n + 1])
        columns = sides(to.ax, to.x, width, softness)
        rows = sides(to.ay, to.y, height, softness)
        for k in ti.static(range(4)):
            if columns[k % 2] * rows[k // 2] > LEAST_WEIGHT:
                i = first + (to.y + k // 2) * width + to.x + k % 2
                if ti.static(cpu):
                    nearest[i] = ti.max(nearest[i], d)
                else:
                    ti.atomic_max(nearest[i], d)

    @ti.kernel
    def nearest_kernel(
        disparity: field,
        offsets: field,
        begin: int,
        count: int,
        softness: float,
        height: int,
        width: int,
        nearest_out: field,
    ):
        """The z-buffer of `count` views from the one numbered `begin` on."""
        size = height * width
        if ti.static(cpu):
            for task in range(count * TASK):
                if task % TASK == 0:
                    n = task // TASK
                    first = n * size
                    for p in range(size):
                        nearest_out[first + p] = NOWHERE
                    for p in range(size):
                        raise_near(disparity, offsets, begin + n, p, height, width, softness, first, nearest_out)
        else:
            for i in range(count * size):
                nearest_out[i] = NOWHERE
            for i in range(count * size):
                n = i // size
                raise_near(disparity, offsets, begin + n, i - n * size, height, width, softness, n * size, nearest_out)

    @ti.kernel
    def visible_kernel(
        disparity: field,
        offsets: field,
        nearest: field,
        softness: float,
        tolerance: float,
        height: int,
        width: int,
        visible_out: field,
    ):
        size = height * width
        for i in range(visible_out.shape[0]):
            n = i // size
            p = i - n * size
            d = disparity[p]
            to = land(p % width, p // width, d, offsets[2 * n], offsets[2 * n + 1])
            free = 0.0
            if within(to.x, to.ax, width) and within(to.y, to.ay, height):
                columns = sides(to.ax, to.x, width, softness)
                rows = sides(to.ay, to.y, height, softness)
                for k in ti.static(range(4)):
                    if columns[k % 2] * rows[k // 2] > LEAST_WEIGHT:
                        if nearest[n * size + (to.y + k // 2) * width + to.x + k % 2] <= d + tolerance:
                            free = 1.0
            visible_out[i] = free

    return SimpleNamespace(nearest=nearest_kernel, visible=visible_kernel, raise_near=raise_near)


def visible(disparity: DeviceArray, offsets: DeviceArray, *, tolerance: float, visible_out: DeviceArray) -> None:
    kernels, size, seen = z_kernels(on_cpu()), disparity.shape, (disparity.values, offsets.values)
    nearest = empty(visible_out.shape)
    run(kernels.nearest, *seen, 0, visible_out.shape[0], _ANY_SOFTNESS, *size, nearest.values)
    run(kernels.visible, *seen, nearest.values, _ANY_SOFTNESS, tolerance, *size, visible_out.values)


@ti.kernel
def _seen_kernel(
    disparity: flat(),
    offsets: flat(),
    known: flat(),
    some_known: ti.template(),
    valid: flat(),
    masked: ti.template(),
    height: int,
    width: int,
    seen_out: flat(),
):
    size = height * width
    for i in range(seen_out.shape[0]):
        n = i // size
        p = i - n * size
        # Where a pixel comes from is where one of the reference lands with the opposite offset.
        place = land(p % width, p // width, disparity[p], -offsets[2 * n], -offsets[2 * n + 1])
        seen = 0.0
        if within(place.x, place.ax, width) and within(place.y, place.ay, height):
            seen = 1.0
            if ti.static(some_known):
                if known[nearest(place.y, place.ay) * width + nearest(place.x, place.ax)] == 0.0:
                    seen = 0.0
            if ti.static(masked):
                if valid[i] == 0.0:
                    seen = 0.0
        seen_out[i] = seen


def seen_by_reference(
    disparity: DeviceArray,
    offsets: DeviceArray,
    known: DeviceArray | None,
    valid: DeviceArray | None,
    *,
    seen_out: DeviceArray,
) -> None:
    inputs = disparity.values, offsets.values, *optional(known), *optional(valid), *disparity.shape
    run(_seen_kernel, *inputs, seen_out.values)
