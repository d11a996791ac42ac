"""The splat with occlusions and its data term; `kernels/reference/occlusion.py` says what they are.

A view is made in two passes over the reference pixels, first the z-buffer, then sums relative to it. A pixel of the
sums is its weighted colours, their weight and the coverage; the data term then turns it into what the gradient gathers.
On a CPU a view belongs to one thread, which needs no atomics. The plan holds a view for each slice there, and as many
as fit into the cache on a GPU, at 24 bytes for each pixel of three channels; `splat_z_buffered` allocates as much for
all its views, and gives it back.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, get_args

import taichi as ti

from lfgpu.contract import DataTerm, Loss

from .landing import land
from .memory import DeviceArray, clear, empty, flat, optional
from .runtime import TASK, on_cpu, once, run
from .sums import Total
from .tent import tent_slope
from .visibility import LEAST_WEIGHT, NOWHERE, sides, z_kernels

_LOSSES = get_args(Loss)
_SQUARES, _CHARBONNIER = _LOSSES.index("squares"), _LOSSES.index("charbonnier")
_SLICES = 16  # of the views on a CPU; fixed, so that results do not depend on the number of threads
_BUFFER = 20 * 2**20  # bytes


@once
def _kernels(channels: int, stored: Any, cpu: bool) -> SimpleNamespace:
    """The kernels for pixels of `channels` values; recorded views are of scalar type `stored`."""
    field, image_type, stored_image = flat(), flat(channels=channels), flat(stored, channels)
    sums_type, sums = flat(channels=channels + 2), ti.types.vector(channels + 2, ti.f32)
    pixel = ti.types.vector(channels, ti.f32)
    raise_near = z_kernels(cpu).raise_near

    @ti.func
    def give(
        image: ti.template(),
        disparity: ti.template(),
        offsets: ti.template(),
        nearest: ti.template(),
        n: int,
        p: int,
        height: int,
        width: int,
        softness: float,
        sharpness: float,
        first: int,
        sums_out: ti.template(),
    ):
        d = disparity[p]
        color = image[p]
        to = land(p % width, p // width, d, offsets[2 * n], offsets[2 * n + 1])
        columns = sides(to.ax, to.x, width, softness)
        rows = sides(to.ay, to.y, height, softness)
        for k in ti.static(range(4)):
            given = columns[k % 2] * rows[k // 2]
            if given > LEAST_WEIGHT:
                i = first + (to.y + k // 2) * width + to.x + k % 2
                weight = given * ti.exp(sharpness * (d - nearest[i]))
                value = sums(0.0)
                for c in ti.static(range(channels)):
                    value[c] = weight * color[c]
                value[channels] = weight
                value[channels + 1] = given
                if ti.static(cpu):
                    sums_out[i] = sums_out[i] + value
                else:
                    ti.atomic_add(sums_out[i], value)

    @ti.func
    def compared(
        total,
        recorded: ti.template(),
        valid: ti.template(),
        masked: ti.template(),
        i: int,
        scale: float,
        least_coverage: float,
        loss: int,
        loss_scale: float,
    ):
        """Of the sums at recorded pixel `i`: G / W, its product with L, and ρ; G is the derivative of ρ by L."""
        value = sums(0.0)
        counts = total[channels + 1] >= least_coverage
        if ti.static(masked):
            if valid[i] == 0.0:
                counts = False
        if counts:
            share = 1.0 / total[channels]
            square = 0.0
            for c in ti.static(range(channels)):
                value[c] = total[c] * share - scale * ti.cast(recorded[i][c], ti.f32)
                square += value[c] * value[c]
            slope = 1.0
            penalty = square
            if loss != _SQUARES:
                excess = 1.0 + square / (loss_scale * loss_scale)
                if loss == _CHARBONNIER:
                    slope = 1.0 / ti.sqrt(excess)
                    penalty = 2.0 * square / (1.0 + ti.sqrt(excess))
                else:
                    slope = 1.0 / (excess * excess)
                    penalty = square / excess
            product = 0.0
            for c in ti.static(range(channels)):
                value[c] *= 2.0 * slope * share
                product += value[c] * (total[c] * share)
            value[channels] = product
            value[channels + 1] = penalty
        return value

    @ti.func
    def slope_of(
        color,
        d: float,
        du: float,
        dv: float,
        x: int,
        y: int,
        nearest: ti.template(),
        residuals: ti.template(),
        first: int,
        height: int,
        width: int,
        softness: float,
        sharpness: float,
    ):
        """What one view says about the disparity `d` of a reference pixel."""
        to = land(x, y, d, du, dv)
        columns = sides(to.ax, to.x, width, softness)
        rows = sides(to.ay, to.y, height, softness)
        slope_x = -du * tent_slope(to.ax, softness)
        slope_y = -dv * tent_slope(to.ay, softness)
        total = 0.0
        for k in ti.static(range(4)):
            given = columns[k % 2] * rows[k // 2]
            if given > LEAST_WEIGHT:
                i = first + (to.y + k // 2) * width + to.x + k % 2
                slope = sharpness * given
                slope += (1 - 2 * (k % 2)) * slope_x * rows[k // 2]
                slope += (1 - 2 * (k // 2)) * slope_y * columns[k % 2]
                residual = residuals[i]
                product = -residual[channels]
                for c in ti.static(range(channels)):
                    product += color[c] * residual[c]
                total += slope * ti.exp(sharpness * (d - nearest[i])) * product
        return total

    @ti.kernel
    def sums_kernel(
        image: image_type,
        disparity: field,
        offsets: field,
        nearest: field,
        begin: int,
        count: int,
        softness: float,
        sharpness: float,
        height: int,
        width: int,
        sums_out: sums_type,
    ):
        """The sums of `count` views from the one numbered `begin` on; they were 0."""
        size = height * width
        if ti.static(cpu):
            for task in range(count * TASK):
                if task % TASK == 0:
                    n = task // TASK
                    for p in range(size):
                        give(
                            image,
                            disparity,
                            offsets,
                            nearest,
                            begin + n,
                            p,
                            height,
                            width,
                            softness,
                            sharpness,
                            n * size,
                            sums_out,
                        )
        else:
            for i in range(count * size):
                n = i // size
                give(
                    image,
                    disparity,
                    offsets,
                    nearest,
                    begin + n,
                    i - n * size,
                    height,
                    width,
                    softness,
                    sharpness,
                    n * size,
                    sums_out,
                )

    @ti.kernel
    def means_kernel(sums_in: sums_type, views_out: image_type, coverage_out: field):
        for i in range(coverage_out.shape[0]):
            total = sums_in[i]
            value = pixel(0.0)
            if total[channels] > 0.0:
                for c in ti.static(range(channels)):
                    value[c] = total[c] / total[channels]
            views_out[i] = value
            coverage_out[i] = total[channels + 1]

    @ti.kernel
    def residual_kernel(
        recorded: stored_image,
        valid: field,
        masked: ti.template(),
        first: int,
        count: int,
        scale: float,
        least_coverage: float,
        loss: int,
        loss_scale: float,
        sums_out: sums_type,
    ):
        """Compares `count` pixels from the one numbered `first` on."""
        for i in range(count):
            sums_out[i] = compared(
                sums_out[i], recorded, valid, masked, first + i, scale, least_coverage, loss, loss_scale
            )

    @ti.kernel
    def gradient_kernel(
        image: image_type,
        disparity: field,
        offsets: field,
        nearest: field,
        residuals: sums_type,
        begin: int,
        count: int,
        softness: float,
        sharpness: float,
        height: int,
        width: int,
        gradient_out: field,
        values_out: flat(ti.f64),
    ):
        """Adds the gradient of some views, and for each pixel what it counts in them."""
        size = height * width
        for p in range(size):
            total = 0.0
            value = 0.0
            for n in range(count):
                du = offsets[2 * (begin + n)]
                dv = offsets[2 * (begin + n) + 1]
                total += slope_of(
                    image[p],
                    disparity[p],
                    du,
                    dv,
                    p % width,
                    p // width,
                    nearest,
                    residuals,
                    n * size,
                    height,
                    width,
                    softness,
                    sharpness,
                )
                value += residuals[n * size + p][channels + 1]
            gradient_out[p] += total
            values_out[p] += ti.cast(value, ti.f64)

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
        sharpness: float,
        least_coverage: float,
        loss: int,
        loss_scale: float,
        height: int,
        width: int,
        slices: int,
        nearest: field,
        residuals: sums_type,
        gradients_out: field,
        values_out: flat(ti.f64),
    ):
        """A slice of the views on each thread of a CPU, one view after the other, so that it stays in its cache."""
        count = offsets.shape[0] // 2
        size = height * width
        for task in range(slices * TASK):
            if task % TASK == 0:
                k = task // TASK
                own = k * size
                for p in range(size):
                    gradients_out[own + p] = 0.0
                for n in range(count * k // slices, count * (k + 1) // slices):
                    for p in range(size):
                        nearest[own + p] = NOWHERE
                        residuals[own + p] = sums(0.0)
                    for p in range(size):
                        raise_near(disparity, offsets, n, p, height, width, softness, own, nearest)
                    for p in range(size):
                        give(
                            image,
                            disparity,
                            offsets,
                            nearest,
                            n,
                            p,
                            height,
                            width,
                            softness,
                            sharpness,
                            own,
                            residuals,
                        )
                    for y in range(height):
                        value = 0.0
                        for x in range(width):
                            p = y * width + x
                            residual = compared(
                                residuals[own + p],
                                recorded,
                                valid,
                                masked,
                                n * size + p,
                                scale,
                                least_coverage,
                                loss,
                                loss_scale,
                            )
                            residuals[own + p] = residual
                            value = value + residual[channels + 1]
                        values_out[n * height + y] = ti.cast(value, ti.f64)
                    for y in range(height):
                        for x in range(width):
                            p = y * width + x
                            gradients_out[own + p] = gradients_out[own + p] + slope_of(
                                image[p],
                                disparity[p],
                                offsets[2 * n],
                                offsets[2 * n + 1],
                                x,
                                y,
                                nearest,
                                residuals,
                                own,
                                height,
                                width,
                                softness,
                                sharpness,
                            )

    @ti.kernel
    def total_kernel(gradients: field, slices: int, gradient_out: field):
        for p in range(gradient_out.shape[0]):
            total = 0.0
            for k in range(slices):
                total += gradients[k * gradient_out.shape[0] + p]
            gradient_out[p] = total

    return SimpleNamespace(
        sums=sums_kernel,
        means=means_kernel,
        residual=residual_kernel,
        gradient=gradient_kernel,
        slice=slice_kernel,
        total=total_kernel,
    )


def splat_z_buffered(
    image: DeviceArray,
    disparity: DeviceArray,
    offsets: DeviceArray,
    *,
    softness: float,
    sharpness: float,
    views_out: DeviceArray,
    coverage_out: DeviceArray,
) -> None:
    assert image.channels is not None
    cpu, size, all_views = on_cpu(), image.shape, (0, coverage_out.shape[0])
    kernels = _kernels(image.channels, ti.f32, cpu)
    nearest = empty(coverage_out.shape)
    sums = clear(empty(coverage_out.shape, channels=image.channels + 2))
    seen = disparity.values, offsets.values
    run(z_kernels(cpu).nearest, *seen, *all_views, softness, *size, nearest.values)
    run(kernels.sums, image.values, *seen, nearest.values, *all_views, softness, sharpness, *size, sums.values)
    run(kernels.means, sums.values, views_out.values, coverage_out.values)


class _OccludingDataTerm:
    """Slices of the views, one view after the other, on a CPU; as many at a time as the cache holds on a GPU."""

    def __init__(
        self,
        shape: Sequence[int],
        offsets: DeviceArray,
        scale: float,
        softness: float,
        sharpness: float,
        compared: tuple[float, int, float],
    ) -> None:
        n, height, width, channels = shape
        self._cpu, self._channels, self._count = on_cpu(), channels, n
        self._slices = min(_SLICES, n) if self._cpu else 1
        most = max(1, _BUFFER // (height * width * 4 * (channels + 3)))
        self._batch = min(most, n)
        views = self._slices if self._cpu else self._batch
        self._nearest = empty((views, height, width))
        self._residuals = empty((views, height, width), channels=channels + 2)
        self._gradients = empty((self._slices, height, width))
        self._values = empty((n * height if self._cpu else height * width,), scalar=ti.f64)
        self._total = Total()
        self._offsets, self._scale, self._softness, self._sharpness = offsets, scale, softness, sharpness
        self._compared = compared

    def load(self, image: DeviceArray, recorded: DeviceArray, valid: DeviceArray | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, optional(valid)
        self._kernels = _kernels(self._channels, recorded.scalar, self._cpu)

    def __call__(self, disparity: DeviceArray, gradient_out: DeviceArray, value_out: DeviceArray) -> None:
        (self._in_slices if self._cpu else self._in_batches)(disparity, gradient_out)
        self._total(self._values, value_out)

    def _in_slices(self, disparity: DeviceArray, gradient_out: DeviceArray) -> None:
        run(
            self._kernels.slice,
            self._image.values,
            disparity.values,
            self._recorded.values,
            *self._valid,
            self._offsets.values,
            self._scale,
            self._softness,
            self._sharpness,
            *self._compared,
            *disparity.shape,
            self._slices,
            self._nearest.values,
            self._residuals.values,
            self._gradients.values,
            self._values.values,
        )
        run(self._kernels.total, self._gradients.values, self._slices, gradient_out.values)

    def _in_batches(self, disparity: DeviceArray, gradient_out: DeviceArray) -> None:
        seen, nearest, residuals = (disparity.values, self._offsets.values), self._nearest, self._residuals
        size, kernels, recorded = disparity.shape, self._kernels, (self._recorded.values, *self._valid)
        clear(gradient_out)
        clear(self._values)
        for first in range(0, self._count, self._batch):
            views = first, min(self._batch, self._count - first)
            pixels = tuple(number * size[0] * size[1] for number in views)
            weights = *views, self._softness, self._sharpness, *size
            clear(residuals)
            run(z_kernels(self._cpu).nearest, *seen, *views, self._softness, *size, nearest.values)
            run(kernels.sums, self._image.values, *seen, nearest.values, *weights, residuals.values)
            run(kernels.residual, *recorded, *pixels, self._scale, *self._compared, residuals.values)
            sources = self._image.values, *seen, nearest.values, residuals.values
            run(kernels.gradient, *sources, *weights, gradient_out.values, self._values.values)


def z_buffered_data_term(
    shape: Sequence[int],
    offsets: DeviceArray,
    *,
    scale: float,
    softness: float,
    sharpness: float,
    least_coverage: float,
    loss: Loss,
    loss_scale: float,
) -> DataTerm:
    compared = least_coverage, _LOSSES.index(loss), loss_scale
    return _OccludingDataTerm(shape, offsets, scale, softness, sharpness, compared)
