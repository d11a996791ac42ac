"""The nearest disparities in each view, and steps that align the views, as `kernels/reference/alignment.py` has them.

The z-buffers of `z_buffer` have a border, so that what lands beyond the frame comes near, too; the plan holds
some views at a time. All that the alignment needs from a view at a place are six numbers for each channel, the mean and
its first and second differences, which six by six stored pixels give. `load` copies the views with a border, a pixel
with whether it is valid, so that no tap needs to look where it is.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import taichi as ti

from lfgpu.contract import GRADIENT_REACH, ZBuffer

from .edges import weigh_edges
from .landing import land, share_of_view, tasks_of_view, within
from .memory import DeviceArray, empty, flat, numpy, optional, table
from .runtime import on_cpu, once, run

_NOWHERE = -1e6  # the disparity of what nothing comes near
_LOWEST = int(np.float32(_NOWHERE).view(np.int32)) ^ 0x7FFFFFFF  # its rank
_AT_REFERENCE = 1e-3  # view steps: what is no farther from the reference is the reference
_BUFFER = 20 * 2**20  # bytes
_TOGETHER = 16  # views on a CPU
_BEFORE, _BORDER = 2, 5  # pixels that copies of views are longer at their left and top, and in all


@once
def _nearest_kernel(cpu: bool) -> Any:
    field = flat()

    @ti.func
    def place_of(p: int, d: float, du: float, dv: float, border: int, height: int, width: int):
        """Compute the place in a bordered view at which pixel p lands, -1 beyond it."""
        wide = width + 2 * border
        to = land(p % width, p // width, d, du, dv)
        x = to.x + border + ti.cast(to.ax >= 0.5, ti.i32)
        y = to.y + border + ti.cast(to.ay >= 0.5, ti.i32)
        place = -1
        if x >= 0 and x < wide and y >= 0 and y < height + 2 * border:
            place = y * wide + x
        return place

    @ti.func
    def swapped(bits: int):
        """Turn the bits of a float32 into its rank, and back: every GPU has a maximum of integers that is atomic."""
        return ti.select(bits < 0, bits ^ 0x7FFFFFFF, bits)

    @ti.func
    def largest_around(fronts: ti.template(), corner: int, side: int, wide: int):
        found = _LOWEST
        for j in range(side):
            for i in range(side):
                found = ti.max(found, fronts[corner + j * wide + i])
        return found

    @ti.func
    def is_there(du: float):
        """True if that is not NaN, by its bits: fast arithmetic knows no NaN."""
        return (ti.bit_cast(du, ti.i32) & 0x7FFFFFFF) <= 0x7F800000

    @ti.kernel
    def nearest_kernel(
        disparity: field,
        offsets: field,
        first: int,
        count: int,
        reach: int,
        height: int,
        width: int,
        fronts: flat(ti.i32),
        nearest_out: field,
    ):
        """`count` views from the one numbered `first` on."""
        border = reach + 1
        wide = width + 2 * border
        room = (height + 2 * border) * wide
        size = height * width
        for i in range(count * room):
            fronts[i] = _LOWEST
        for task in range(count * tasks_of_view(size, cpu)):
            n, start, end = share_of_view(task, size, cpu)
            du = offsets[2 * (first + n)]
            dv = offsets[2 * (first + n) + 1]
            for p in range(start, ti.select(is_there(du), end, start)):
                d = disparity[p]
                place = place_of(p, d, du, dv, border, height, width)
                if place >= 0:
                    rank = swapped(ti.bit_cast(d, ti.i32))
                    if ti.static(cpu):
                        fronts[n * room + place] = ti.max(fronts[n * room + place], rank)
                    else:
                        ti.atomic_max(fronts[n * room + place], rank)
        for i in range(count * size):
            n = i // size
            if is_there(offsets[2 * (first + n)]):
                p = i - n * size
                corner = n * room + p // width * wide + p % width
                found = largest_around(fronts, corner + wide + 1, 2 * reach + 1, wide)
                if found == _LOWEST:
                    found = largest_around(fronts, corner, 2 * reach + 3, wide)
                nearest_out[first * size + i] = ti.bit_cast(swapped(found), ti.f32)

    return nearest_kernel


def z_buffer(size: Sequence[int], device: str, *, reach: int) -> ZBuffer:
    height, width = size
    room = (height + 2 * reach + 2) * (width + 2 * reach + 2)
    batch = _TOGETHER if on_cpu() else max(1, _BUFFER // (4 * room))
    fronts, kernel = empty((batch * room,), scalar=ti.i32), _nearest_kernel(on_cpu())

    def find(disparity: DeviceArray, offsets: DeviceArray, nearest_out: DeviceArray, *, reach: int) -> None:
        count = offsets.shape[0]
        for first in range(0, count, batch):
            some = first, min(batch, count - first), reach, height, width
            run(kernel, disparity, offsets, *some, fronts, nearest_out)

    return find


@ti.dataclass
class Place:
    """The first of four taps, or -1 where the view takes no part, and how far beyond it."""

    corner: ti.i32
    ax: ti.f32
    ay: ti.f32


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    """Views are of scalar type `stored`."""
    pad = channels + 1
    field, pixel, kept = flat(), ti.types.vector(channels, ti.f32), ti.types.vector(pad, stored)

    @ti.kernel
    def pack_kernel(
        recorded: flat(stored, channels),
        valid: field,
        masked: ti.template(),
        height: int,
        width: int,
        packed_out: flat(stored, pad),
    ):
        """Copies views continued by their border pixels; what is there last is whether the pixel is valid."""
        wide = width + _BORDER
        room = (height + _BORDER) * wide
        for i in range(packed_out.shape[0]):
            n = i // room
            p = i - n * room
            y = ti.min(ti.max(p // wide - _BEFORE, 0), height - 1)
            x = ti.min(ti.max(p % wide - _BEFORE, 0), width - 1)
            source = (n * height + y) * width + x
            packed = kept(0)
            for c in ti.static(range(channels)):
                packed[c] = recorded[source][c]
            counts = True
            if ti.static(masked):
                counts = valid[source] != 0.0
            if counts:
                packed[channels] = ti.cast(1, stored)
            packed_out[i] = packed

    @ti.func
    def landing(
        n: int,
        p: int,
        d: float,
        offsets: ti.template(),
        nearest: ti.template(),
        tolerance: float,
        height: int,
        width: int,
        views: ti.template(),
    ):
        du = offsets[2 * n]
        dv = offsets[2 * n + 1]
        to = land(p % width, p // width, d, du, dv)
        corner = -1
        other = du * du + dv * dv > _AT_REFERENCE * _AT_REFERENCE
        if other and within(to.x, to.ax, width) and within(to.y, to.ay, height):
            next_x = ti.cast(to.ax >= 0.5, ti.i32)
            next_y = ti.cast(to.ay >= 0.5, ti.i32)
            if d >= nearest[(n * height + to.y + next_y) * width + to.x + next_x] - tolerance:
                wide = width + _BORDER
                corner = (n * (height + _BORDER) + to.y + _BEFORE) * wide + to.x + _BEFORE
                if ti.cast(views[corner + next_y * wide + next_x][channels], ti.f32) == 0.0:
                    corner = -1
        return Place(corner=corner, ax=to.ax, ay=to.ay)

    @ti.func
    def color(image: ti.template(), x: int, y: int, height: int, width: int):
        return image[ti.min(ti.max(y, 0), height - 1) * width + ti.min(ti.max(x, 0), width - 1)]

    @ti.func
    def value(views: ti.template(), i: int):
        packed = views[i]
        result = pixel(0.0)
        for c in ti.static(range(channels)):
            result[c] = ti.cast(packed[c], ti.f32)
        return result

    @ti.func
    def mean_along(views: ti.template(), i: int, a: float):
        return value(views, i) * (1.0 - a) + value(views, i + 1) * a

    @ti.func
    def slope_along(views: ti.template(), i: int, a: float):
        """Twice the difference."""
        across = (value(views, i + 1) - value(views, i - 1)) * (1.0 - a)
        return across + (value(views, i + 2) - value(views, i)) * a

    @ti.func
    def bend_along(views: ti.template(), i: int, a: float):
        """Four times the second difference."""
        return mean_along(views, i - 2, a) + mean_along(views, i + 2, a) - 2.0 * mean_along(views, i, a)

    @ti.func
    def weight_of(square: float, robust: float):
        excess = 1.0 + square / (3 * channels * robust * robust)
        return 1.0 / (excess * excess)

    @ti.kernel
    def align_kernel(
        image: flat(channels=channels),
        weights: field,
        views: flat(stored, pad),
        offsets: field,
        scale: float,
        robust: float,
        tolerance: float,
        share_of_all: float,
        disparity: field,
        nearest: field,
        height: int,
        width: int,
        curvature_out: field,
        slope_out: field,
    ):
        wide = width + _BORDER
        for p in range(slope_out.shape[0]):
            x = p % width
            y = p // width
            d = disparity[p]
            weight = weights[p]
            own = image[p]
            own_x = 0.5 * (color(image, x + 1, y, height, width) - color(image, x - 1, y, height, width))
            own_y = 0.5 * (color(image, x, y + 1, height, width) - color(image, x, y - 1, height, width))
            mean = own
            mean_x = own_x
            mean_y = own_y
            total = 1.0
            for n in range(offsets.shape[0] // 2):
                to = landing(n, p, d, offsets, nearest, tolerance, height, width, views)
                if to.corner >= 0:
                    i = to.corner
                    by = 1.0 - to.ay
                    m0 = mean_along(views, i - wide, to.ax)
                    m1 = mean_along(views, i, to.ax)
                    m2 = mean_along(views, i + wide, to.ax)
                    m3 = mean_along(views, i + 2 * wide, to.ax)
                    s1 = slope_along(views, i, to.ax)
                    s2 = slope_along(views, i + wide, to.ax)
                    f = scale * (m1 * by + m2 * to.ay)
                    fx = 0.5 * scale * (s1 * by + s2 * to.ay)
                    fy = 0.5 * scale * ((m2 - m0) * by + (m3 - m1) * to.ay)
                    of_gradients = (fx - own_x).norm_sqr() + (fy - own_y).norm_sqr()
                    k = weight_of((f - own).norm_sqr() + weight * weight * of_gradients, robust)
                    mean += k * f
                    mean_x += k * fx
                    mean_y += k * fy
                    total += k
            mean /= total
            mean_x /= total
            mean_y /= total
            # Their changes, across and down, from which the derivatives by d are; offsets times residuals, and squared.
            change_x = own_x
            change_y = own_y
            change_xx = color(image, x + 2, y, height, width) + color(image, x - 2, y, height, width) - 2.0 * own
            change_yy = color(image, x, y + 2, height, width) + color(image, x, y - 2, height, width) - 2.0 * own
            above = color(image, x + 1, y - 1, height, width) - color(image, x - 1, y - 1, height, width)
            change_xy = color(image, x + 1, y + 1, height, width) - color(image, x - 1, y + 1, height, width) - above
            change_xx *= 0.25
            change_xy *= 0.25
            change_yy *= 0.25
            right = pixel(0.0)
            right_x = pixel(0.0)
            right_y = pixel(0.0)
            below = pixel(0.0)
            below_x = pixel(0.0)
            below_y = pixel(0.0)
            uu = 0.0
            uv = 0.0
            vv = 0.0
            total = 1.0
            for n in range(offsets.shape[0] // 2):
                to = landing(n, p, d, offsets, nearest, tolerance, height, width, views)
                if to.corner >= 0:
                    i = to.corner
                    by = 1.0 - to.ay
                    m0 = mean_along(views, i - 2 * wide, to.ax)
                    m1 = mean_along(views, i - wide, to.ax)
                    m2 = mean_along(views, i, to.ax)
                    m3 = mean_along(views, i + wide, to.ax)
                    m4 = mean_along(views, i + 2 * wide, to.ax)
                    m5 = mean_along(views, i + 3 * wide, to.ax)
                    s1 = slope_along(views, i - wide, to.ax)
                    s2 = slope_along(views, i, to.ax)
                    s3 = slope_along(views, i + wide, to.ax)
                    s4 = slope_along(views, i + 2 * wide, to.ax)
                    t2 = bend_along(views, i, to.ax)
                    t3 = bend_along(views, i + wide, to.ax)
                    fx = 0.5 * scale * (s2 * by + s3 * to.ay)
                    fy = 0.5 * scale * ((m3 - m1) * by + (m4 - m2) * to.ay)
                    r = scale * (m2 * by + m3 * to.ay) - mean
                    rx = weight * (fx - mean_x)
                    ry = weight * (fy - mean_y)
                    k = weight_of(r.norm_sqr() + rx.norm_sqr() + ry.norm_sqr(), robust)
                    change_x += k * fx
                    change_y += k * fy
                    change_xx += k * 0.25 * scale * (t2 * by + t3 * to.ay)
                    change_xy += k * 0.25 * scale * ((s3 - s1) * by + (s4 - s2) * to.ay)
                    change_yy += k * 0.25 * scale * ((m0 + m4 - 2.0 * m2) * by + (m1 + m5 - 2.0 * m3) * to.ay)
                    ku = k * offsets[2 * n]
                    kv = k * offsets[2 * n + 1]
                    right += ku * r
                    right_x += ku * rx
                    right_y += ku * ry
                    below += kv * r
                    below_x += kv * rx
                    below_y += kv * ry
                    uu += ku * offsets[2 * n]
                    uv += ku * offsets[2 * n + 1]
                    vv += kv * offsets[2 * n + 1]
                    total += k
            change_x /= total
            change_y /= total
            change_xx *= weight / total
            change_xy *= weight / total
            change_yy *= weight / total
            # Against the derivatives by d, so that their product with the residuals is what the slope adds up.
            across = change_x.norm_sqr() + change_xx.norm_sqr() + change_xy.norm_sqr()
            both = change_x.dot(change_y) + change_xx.dot(change_xy) + change_xy.dot(change_yy)
            down = change_y.norm_sqr() + change_xy.norm_sqr() + change_yy.norm_sqr()
            curvature = across * uu + 2.0 * both * uv + down * vv
            slope = change_x.dot(right) + change_xx.dot(right_x) + change_xy.dot(right_y)
            slope += change_y.dot(below) + change_xy.dot(below_x) + change_yy.dot(below_y)
            curvature_out[p] = share_of_all * curvature
            slope_out[p] = share_of_all * slope

    return SimpleNamespace(pack=pack_kernel, align=align_kernel)


class alignment:
    def __init__(
        self,
        shape: Sequence[int],
        offsets: DeviceArray,
        *,
        scale: float,
        gradient_weight: float,
        contrast: float,
        robust: float,
        tolerance: float,
        shared: Any = None,
    ) -> None:
        places = np.nan_to_num(numpy(offsets))  # what is left out is taken for the reference
        self._shape, self._offsets = tuple(shape), table(places)
        others = int((np.hypot(*places.T) > _AT_REFERENCE).sum())
        share_of_all = 1 / (3 * shape[3] * max(others, 1))
        self._weighing = gradient_weight, contrast, GRADIENT_REACH
        self._compared = scale, robust, tolerance, share_of_all
        self._loaded = SimpleNamespace(weights=empty(shape[1:3]), packed=None) if shared is None else shared._loaded

    def room(self, stored: Any) -> int:
        return 0

    def load(self, image: DeviceArray, recorded: DeviceArray, valid: DeviceArray | None, room: Any = None) -> None:
        n, height, width, channels = self._shape
        loaded = self._loaded
        loaded.kernels = _kernels(channels, recorded.scalar)
        if loaded.packed is None or loaded.packed.scalar is not recorded.scalar:
            size = n, height + _BORDER, width + _BORDER
            loaded.packed = empty(size, channels=channels + 1, scalar=recorded.scalar)
        loaded.image = image
        # What is near a step in brightness sees it in its gradients.
        weigh_edges(image, *self._weighing, weights_out=loaded.weights)
        run(loaded.kernels.pack, recorded, *optional(valid), height, width, loaded.packed)

    def __call__(
        self, disparity: DeviceArray, nearest: DeviceArray, curvature_out: DeviceArray, slope_out: DeviceArray
    ) -> None:
        loaded = self._loaded
        views = loaded.image, loaded.weights, loaded.packed, self._offsets
        maps = disparity, nearest, *disparity.shape
        run(loaded.kernels.align, *views, *self._compared, *maps, curvature_out, slope_out)
