"""The data term, and what the reference sees of other views.

A GPU gives a channel of some pixels above each other a thread, so that neighbours add to neighbouring numbers, and what
lands on the same place adds up atomically. On a CPU, where atomics cost several times as much, a view belongs to one
thread.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import taichi as ti

from .landing import inside, land, nearest, tent, tent_slope, within
from .memory import DeviceArray, empty, flat, numpy, operation, optional
from .runtime import TASK, double, on_cpu, once, run
from .sums import BLOCK, PARTS, add_up, share, summing

_SLICES = 16  # of the views on a CPU; fixed, so that results do not depend on the number of threads
_ROWS = 8  # of a column, which a thread of a GPU adds one after the other: what two of them add to a place it adds once


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    """Return the kernels for pixels of `channels` values; recorded views are of scalar type `stored`."""
    real, sums = double(), summing()
    field, image_type, stored_image = flat(), flat(channels=channels), flat(stored, channels)
    pixel = ti.types.vector(channels, ti.f32)

    @ti.func
    def add(target: ti.template(), i: int, value):
        target[i] = target[i] + value  # `+=` would be atomic

    @ti.func
    def give(target: ti.template(), first: int, to, height: int, width: int, w00, w01, w10, w11):
        """Add what goes to the four pixels, as far as they lie in the view that begins at `first`."""
        i = first + to.y * width + to.x
        if inside(to.x, to.y, height - 1, width - 1):
            add(target, i, w00)
            add(target, i + 1, w01)
            add(target, i + width, w10)
            add(target, i + width + 1, w11)
        else:
            if inside(to.x, to.y, height, width):
                add(target, i, w00)
            if inside(to.x + 1, to.y, height, width):
                add(target, i + 1, w01)
            if inside(to.x, to.y + 1, height, width):
                add(target, i + width, w10)
            if inside(to.x + 1, to.y + 1, height, width):
                add(target, i + width + 1, w11)

    @ti.func
    def give_two(views: ti.template(), n: int, x: int, y: int, c: int, height: int, width: int, left, right):
        """Add to a channel of the pixels (x, y) and (x + 1, y) of view n atomically, as far as they lie in it."""
        if y >= 0 and y < height:
            i = (n * height + y) * width + x
            if x >= 0 and x < width:
                ti.atomic_add(views[i][c], left)
            if x >= -1 and x + 1 < width:
                ti.atomic_add(views[i + 1][c], right)

    @ti.func
    def at(image: ti.template(), first: int, x: int, y: int, height: int, width: int):
        value = pixel(0.0)
        if inside(x, y, height, width):
            value = image[first + y * width + x]
        return value

    @ti.func
    def give_color(
        image: ti.template(),
        disparity: ti.template(),
        offsets: ti.template(),
        n: int,
        p: int,
        height: int,
        width: int,
        softness: float,
        first: int,
        views: ti.template(),
    ):
        to = land(p % width, p // width, disparity[p], offsets[2 * n], offsets[2 * n + 1])
        wx = tent(to.ax, softness)
        wy = tent(to.ay, softness)
        left = image[p] * wx
        right = image[p] * (1.0 - wx)
        give(views, first, to, height, width, left * wy, right * wy, left * (1.0 - wy), right * (1.0 - wy))

    @ti.func
    def slope_of(
        value,
        d: float,
        du: float,
        dv: float,
        x: int,
        y: int,
        residual: ti.template(),
        first: int,
        height: int,
        width: int,
        softness: float,
    ):
        """Differentiate one view's squared error by the disparity `d` of a reference pixel of colour `value`."""
        to = land(x, y, d, du, dv)
        wx = tent(to.ax, softness)
        wy = tent(to.ay, softness)
        sx = -du * tent_slope(to.ax, softness)
        sy = -dv * tent_slope(to.ay, softness)
        a00 = value.dot(at(residual, first, to.x, to.y, height, width))
        a01 = value.dot(at(residual, first, to.x + 1, to.y, height, width))
        a10 = value.dot(at(residual, first, to.x, to.y + 1, height, width))
        a11 = value.dot(at(residual, first, to.x + 1, to.y + 1, height, width))
        return sx * (wy * (a00 - a01) + (1.0 - wy) * (a10 - a11)) + sy * (wx * (a00 - a10) + (1.0 - wx) * (a01 - a11))

    @ti.func
    def difference(
        predicted, recorded: ti.template(), valid: ti.template(), masked: ti.template(), i: int, scale: float
    ):
        """Compute the residual at recorded pixel `i`; 0 where it does not count."""
        value = predicted - scale * ti.cast(recorded[i], ti.f32)
        if ti.static(masked):
            if valid[i] == 0.0:
                value = pixel(0.0)
        return value

    @ti.kernel
    def splat_kernel(
        image: image_type,
        disparity: field,
        offsets: field,
        softness: float,
        height: int,
        width: int,
        views_out: image_type,
    ):
        for i in range(views_out.shape[0]):
            views_out[i] = pixel(0.0)
        strips = (height + _ROWS - 1) // _ROWS
        for i in range(offsets.shape[0] // 2 * strips * width * channels):
            n = i // (strips * width * channels)
            top = i // (width * channels) % strips * _ROWS
            x = i // channels % width
            c = i % channels
            # What the pixel before gives to the two places below it.
            left = 0.0
            right = 0.0
            at_x = 0
            at_y = -1
            for y in range(top, ti.min(top + _ROWS, height)):
                p = y * width + x
                to = land(x, y, disparity[p], offsets[2 * n], offsets[2 * n + 1])
                wx = tent(to.ax, softness)
                wy = tent(to.ay, softness)
                if to.x != at_x or to.y != at_y:
                    give_two(views_out, n, at_x, at_y, c, height, width, left, right)
                    left = 0.0
                    right = 0.0
                value = image[p][c] * wx
                beside = image[p][c] * (1.0 - wx)
                give_two(views_out, n, to.x, to.y, c, height, width, left + value * wy, right + beside * wy)
                left = value * (1.0 - wy)
                right = beside * (1.0 - wy)
                at_x = to.x
                at_y = to.y + 1
            give_two(views_out, n, at_x, at_y, c, height, width, left, right)

    @ti.kernel
    def compare_kernel(
        image: image_type,
        disparity: field,
        recorded: stored_image,
        valid: field,
        masked: ti.template(),
        offsets: field,
        scale: float,
        softness: float,
        height: int,
        width: int,
        residuals: image_type,
        squares: flat(real),
        gradient_out: field,
        value_out: flat(real),
    ):
        """Turn predicted views into residuals, add up their squares, and follow them back to the reference."""
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.turns):
            i, step, end = share(turn, sums.turns, recorded.shape[0], sums.cpu)
            term = ti.cast(0.0, real)
            while i < end:
                value = difference(residuals[i], recorded, valid, masked, i, scale)
                residuals[i] = value
                term += ti.cast(value.norm_sqr(), real)
                i += step
            sums.keep(term, turn, squares)
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.threads):
            total = sums.total(squares, 0, PARTS, turn)
            if turn == 0:
                value_out[0] = total
        for p in range(gradient_out.shape[0]):
            total = 0.0
            for n in range(offsets.shape[0] // 2):
                total += slope_of(
                    image[p],
                    disparity[p],
                    offsets[2 * n],
                    offsets[2 * n + 1],
                    p % width,
                    p // width,
                    residuals,
                    n * height * width,
                    height,
                    width,
                    softness,
                )
            gradient_out[p] = 2.0 * total

    @ti.kernel
    def slice_kernel(
        image: image_type,
        disparity: field,
        recorded: stored_image,
        valid: field,
        masked: ti.template(),
        offsets: field,
        scale: float,
        softness: float,
        height: int,
        width: int,
        slices: int,
        residuals: image_type,
        gradients_out: field,
        squares_out: flat(real),
    ):
        """Compute a slice of the views on each thread of a CPU, view after view, so that it stays in the cache."""
        count = offsets.shape[0] // 2
        size = height * width
        for task in range(slices * TASK):
            if task % TASK == 0:
                k = task // TASK
                own = k * size
                for p in range(size):
                    gradients_out[own + p] = 0.0
                for n in range(count * k // slices, count * (k + 1) // slices):
                    du = offsets[2 * n]
                    dv = offsets[2 * n + 1]
                    for p in range(size):
                        residuals[own + p] = pixel(0.0)
                    for p in range(size):
                        give_color(image, disparity, offsets, n, p, height, width, softness, own, residuals)
                    for y in range(height):
                        total = 0.0
                        for x in range(width):
                            p = y * width + x
                            value = difference(residuals[own + p], recorded, valid, masked, n * size + p, scale)
                            residuals[own + p] = value
                            total = total + value.norm_sqr()
                        squares_out[n * height + y] = ti.cast(total, real)
                    for y in range(height):
                        for x in range(width):
                            p = y * width + x
                            slope = slope_of(
                                image[p], disparity[p], du, dv, x, y, residuals, own, height, width, softness
                            )
                            gradients_out[own + p] = gradients_out[own + p] + slope

    @ti.kernel
    def total_kernel(gradients: field, slices: int, gradient_out: field):
        for p in range(gradient_out.shape[0]):
            total = 0.0
            for k in range(slices):
                total += gradients[k * gradient_out.shape[0] + p]
            gradient_out[p] = 2.0 * total

    @ti.kernel
    def curvature_kernel(image: image_type, factor: float, curvature_out: field):
        for p in range(curvature_out.shape[0]):
            curvature_out[p] = factor * image[p].norm_sqr()

    return SimpleNamespace(
        splat=splat_kernel,
        compare=compare_kernel,
        slice=slice_kernel,
        total=total_kernel,
        curvature=curvature_kernel,
    )


class data_term:
    """Slices of the views, one view after the other, on a CPU; all of them at once on a GPU."""

    def __init__(self, shape: Sequence[int], offsets: DeviceArray, *, scale: float, softness: float) -> None:
        n, height, width, channels = shape
        self._cpu, self._channels = on_cpu(), channels
        self._slices = min(_SLICES, n) if self._cpu else 1
        self._residuals = empty((self._slices if self._cpu else n, height, width), channels=channels)
        self._gradients = empty((self._slices, height, width))
        self._squares = empty((n * height if self._cpu else PARTS,), scalar=double())
        self._offsets, self._scale, self._softness = offsets, scale, softness
        self._curvature = 2.0 * float((numpy(offsets).astype(np.float64) ** 2).sum())

    def load(self, image: DeviceArray, recorded: DeviceArray, valid: DeviceArray | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, optional(valid)
        self._kernels = _kernels(self._channels, recorded.scalar)

    def __call__(self, disparity: DeviceArray, gradient_out: DeviceArray, value_out: DeviceArray) -> None:
        kernels, size = self._kernels, disparity.shape
        compared = self._image, disparity, self._recorded, *self._valid, self._offsets, self._scale, self._softness
        if self._cpu:
            kept = self._residuals, self._gradients, self._squares
            run(kernels.slice, *compared, *size, self._slices, *kept)
            run(kernels.total, self._gradients, self._slices, gradient_out)
            add_up(self._squares, value_out)
        else:
            run(kernels.splat, self._image, disparity, self._offsets, self._softness, *size, self._residuals)
            run(kernels.compare, *compared, *size, self._residuals, self._squares, gradient_out, value_out)

    def curvature(self, curvature_out: DeviceArray) -> None:
        run(self._kernels.curvature, self._image, self._curvature, curvature_out)


@operation
@ti.kernel
def seen_by_reference(
    disparity: flat(),
    offsets: flat(),
    known: flat(),
    valid: flat(),
    has_known: ti.template(),
    has_valid: ti.template(),
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
            if ti.static(has_known):
                if known[nearest(place.y, place.ay) * width + nearest(place.x, place.ax)] == 0.0:
                    seen = 0.0
            if ti.static(has_valid):
                if valid[i] == 0.0:
                    seen = 0.0
        seen_out[i] = seen
