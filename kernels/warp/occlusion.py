"""The splat with occlusions, its data term, and what other views see; `kernels/reference/occlusion.py` says what it is.

A view is made in two passes over the reference pixels, first the z-buffer, then sums relative to it. A pixel of the
sums is its weighted colours, their weight and the coverage; the data term then turns it into what the gradient gathers.
The plan holds a view for each slice on a CPU, and as many as fit into the cache on a GPU, at 24 bytes for each pixel of
three channels. `splat_z_buffered` allocates as much for all its views, `visible` 4 bytes, and both give it back.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, get_args

import warp as wp

from lfgpu.contract import DataTerm, Loss

from .memory import pixel_type
from .splat import as_offsets, land
from .tent import foot, tent_slope
from .threads import in_slices, lanes, launch, launch_rows, launch_tiles, load, once, slices
from .vector import BLOCK, sum_kernel

_LOSSES = get_args(Loss)
_SQUARES, _CHARBONNIER = wp.constant(_LOSSES.index("squares")), wp.constant(_LOSSES.index("charbonnier"))
_LEAST_WEIGHT = wp.constant(1e-20)
_NOWHERE = wp.constant(-3e38)  # the disparity of what is not there
_BUFFER = 20 * 2**20  # bytes
_ANY_SOFTNESS = 0.5  # whatever it is, the same pixels are reached


@wp.struct
class Taps:
    """Where a reference pixel lands, and what it gives to the columns and rows there and next; 0 outside the frame."""

    x: wp.int32
    y: wp.int32
    ax: wp.float32
    ay: wp.float32
    columns: wp.vec2f
    rows: wp.vec2f


@wp.func
def taps(x: int, y: int, height: int, width: int, disparity: float, offset: wp.vec2f, softness: float) -> Taps:
    to = land(x, y, disparity, offset)
    left = foot(1.0 - to.ax, softness)
    right = foot(to.ax, softness)
    upper = foot(1.0 - to.ay, softness)
    lower = foot(to.ay, softness)
    if to.x < 0 or to.x >= width:
        left = 0.0
    if to.x < -1 or to.x >= width - 1:
        right = 0.0
    if to.y < 0 or to.y >= height:
        upper = 0.0
    if to.y < -1 or to.y >= height - 1:
        lower = 0.0
    result = Taps()
    result.x = to.x
    result.y = to.y
    result.ax = to.ax
    result.ay = to.ay
    result.columns = wp.vec2f(left, right)
    result.rows = wp.vec2f(upper, lower)
    return result


@wp.kernel(enable_backward=False)
def _nearest_kernel(
    disparity: wp.array2d(dtype=float),
    offsets: wp.array(dtype=wp.vec2f),
    softness: float,
    lanes: int,
    nearest_out: wp.array3d(dtype=float),
):
    n, y, lane = wp.tid()
    for x in range(lane, disparity.shape[1], lanes):
        d = disparity[y, x]
        to = taps(x, y, disparity.shape[0], disparity.shape[1], d, offsets[n], softness)
        for k in range(4):
            if to.columns[k % 2] * to.rows[k / 2] > _LEAST_WEIGHT:
                wp.atomic_max(nearest_out, n, to.y + k / 2, to.x + k % 2, d)


@wp.kernel(enable_backward=False)
def _visible_kernel(
    disparity: wp.array2d(dtype=float),
    offsets: wp.array(dtype=wp.vec2f),
    nearest: wp.array3d(dtype=float),
    softness: float,
    tolerance: float,
    lanes: int,
    visible_out: wp.array3d(dtype=float),
):
    n, y, lane = wp.tid()
    height = disparity.shape[0]
    width = disparity.shape[1]
    for x in range(lane, width, lanes):
        d = disparity[y, x]
        to = taps(x, y, height, width, d, offsets[n], softness)
        within_x = to.x >= 0 and (to.x < width - 1 or (to.x == width - 1 and to.ax == 0.0))
        within_y = to.y >= 0 and (to.y < height - 1 or (to.y == height - 1 and to.ay == 0.0))
        free = float(0.0)
        if within_x and within_y:
            for k in range(4):
                reached = to.columns[k % 2] * to.rows[k / 2] > _LEAST_WEIGHT
                if reached and nearest[n, to.y + k / 2, to.x + k % 2] <= d + tolerance:
                    free = 1.0
        visible_out[n, y, x] = free


@wp.kernel(enable_backward=False)
def _total_kernel(gradients: wp.array3d(dtype=float), row: int, lanes: int, gradient_out: wp.array2d(dtype=float)):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, gradients.shape[2], lanes):
        total = float(0.0)
        for k in range(gradients.shape[0]):
            total = total + gradients[k, y, x]
        gradient_out[y, x] = total


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    """The kernels for pixels of `channels` values; recorded views are of scalar type `stored`."""
    pixel, stored_pixel = pixel_type(channels), pixel_type(channels, stored)
    sums = pixel_type(channels + 2)
    module = f"lfgpu_occlusion_{channels}_{stored.__name__}"

    @wp.kernel(module=module, enable_backward=False)
    def sums_kernel(
        image: wp.array2d(dtype=pixel),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        nearest: wp.array3d(dtype=float),
        softness: float,
        sharpness: float,
        lanes: int,
        sums_out: wp.array3d(dtype=sums),
    ):
        n, y, lane = wp.tid()
        for x in range(lane, image.shape[1], lanes):
            d = disparity[y, x]
            color = image[y, x]
            to = taps(x, y, image.shape[0], image.shape[1], d, offsets[n], softness)
            for k in range(4):
                given = to.columns[k % 2] * to.rows[k / 2]
                if given > _LEAST_WEIGHT:
                    tx = to.x + k % 2
                    ty = to.y + k / 2
                    weight = given * wp.exp(sharpness * (d - nearest[n, ty, tx]))
                    value = sums()
                    for c in range(wp.static(channels)):
                        value[c] = color[c] * weight
                    value[wp.static(channels)] = weight
                    value[wp.static(channels + 1)] = given
                    wp.atomic_add(sums_out, n, ty, tx, value)

    @wp.kernel(module=module, enable_backward=False)
    def means_kernel(
        sums_in: wp.array3d(dtype=sums),
        lanes: int,
        views_out: wp.array3d(dtype=pixel),
        coverage_out: wp.array3d(dtype=float),
    ):
        n, y, lane = wp.tid()
        for x in range(lane, sums_in.shape[2], lanes):
            total = sums_in[n, y, x]
            value = pixel()
            if total[wp.static(channels)] > 0.0:
                for c in range(wp.static(channels)):
                    value[c] = total[c] / total[wp.static(channels)]
            views_out[n, y, x] = value
            coverage_out[n, y, x] = total[wp.static(channels + 1)]

    @wp.kernel(module=module, enable_backward=False)
    def residual_kernel(
        recorded: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        first: int,
        scale: float,
        least_coverage: float,
        loss: int,
        loss_scale: float,
        lanes: int,
        sums_out: wp.array3d(dtype=sums),
    ):
        """Turns sums into G / W, its product with the prediction L, and ρ; G is the derivative of ρ by L."""
        n, y, lane = wp.tid()
        for x in range(lane, sums_out.shape[2], lanes):
            total = sums_out[n, y, x]
            value = sums()
            counts = total[wp.static(channels + 1)] >= least_coverage
            if valid and valid[first + n, y, x] == 0.0:
                counts = False
            if counts:
                share = 1.0 / total[wp.static(channels)]
                stored_value = recorded[first + n, y, x]
                square = float(0.0)
                for c in range(wp.static(channels)):
                    residual = total[c] * share - scale * float(stored_value[c])
                    value[c] = residual
                    square = square + residual * residual
                slope = float(1.0)
                penalty = square
                if loss != _SQUARES:
                    excess = 1.0 + square / (loss_scale * loss_scale)
                    if loss == _CHARBONNIER:
                        slope = 1.0 / wp.sqrt(excess)
                        penalty = 2.0 * square / (1.0 + wp.sqrt(excess))
                    else:
                        slope = 1.0 / (excess * excess)
                        penalty = square / excess
                product = float(0.0)
                for c in range(wp.static(channels)):
                    value[c] = value[c] * (2.0 * slope * share)
                    product = product + value[c] * (total[c] * share)
                value[wp.static(channels)] = product
                value[wp.static(channels + 1)] = penalty
            sums_out[n, y, x] = value

    @wp.kernel(module=module, enable_backward=False)
    def gradient_kernel(
        image: wp.array2d(dtype=pixel),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        nearest: wp.array3d(dtype=float),
        residuals: wp.array3d(dtype=sums),
        softness: float,
        sharpness: float,
        lanes: int,
        gradient_out: wp.array2d(dtype=float),
        values_out: wp.array2d(dtype=wp.float64),
    ):
        """Adds the gradient of some views, and row by row what their pixels count."""
        i = wp.tid()
        y = i / lanes
        lane = i % lanes
        value = float(0.0)
        for x in range(lane, image.shape[1], lanes):
            d = disparity[y, x]
            color = image[y, x]
            total = float(0.0)
            for n in range(offsets.shape[0]):
                offset = offsets[n]
                to = taps(x, y, image.shape[0], image.shape[1], d, offset, softness)
                slope_x = -offset[0] * tent_slope(to.ax, softness)
                slope_y = -offset[1] * tent_slope(to.ay, softness)
                for k in range(4):
                    given = to.columns[k % 2] * to.rows[k / 2]
                    if given > _LEAST_WEIGHT:
                        tx = to.x + k % 2
                        ty = to.y + k / 2
                        slope = sharpness * given
                        slope = slope + float(1 - 2 * (k % 2)) * slope_x * to.rows[k / 2]
                        slope = slope + float(1 - 2 * (k / 2)) * slope_y * to.columns[k % 2]
                        residual = residuals[n, ty, tx]
                        product = -residual[wp.static(channels)]
                        for c in range(wp.static(channels)):
                            product = product + color[c] * residual[c]
                        total = total + slope * wp.exp(sharpness * (d - nearest[n, ty, tx])) * product
                value = value + residuals[n, y, x][wp.static(channels + 1)]
            gradient_out[y, x] = gradient_out[y, x] + total
        values_out[y, lane] = values_out[y, lane] + wp.float64(value)

    return SimpleNamespace(sums=sums_kernel, means=means_kernel, residual=residual_kernel, gradient=gradient_kernel)


def _find_nearest(disparity: Any, offsets: Any, softness: float, nearest_out: Any) -> None:
    """The z-buffer [n, y, x] of views at `offsets`, pairs."""
    threads = lanes(disparity)
    nearest_out.fill_(_NOWHERE)
    dim = (len(offsets), disparity.shape[0], threads)
    inputs = [disparity, offsets, softness, threads]
    launch(_nearest_kernel, dim, inputs, [nearest_out], device=disparity.device)


def splat_z_buffered(
    image: Any,
    disparity: Any,
    offsets: Any,
    *,
    softness: float,
    sharpness: float,
    views_out: Any,
    coverage_out: Any,
) -> None:
    channels, device, threads, pairs = image.dtype._length_, image.device, lanes(image), as_offsets(offsets)
    kernels = _kernels(channels, wp.float32)
    load(device, kernels.sums, _nearest_kernel)

    def some_views(_: int, first: int, last: int) -> None:
        views, coverage, some = views_out[first:last], coverage_out[first:last], pairs[first:last]
        nearest = wp.empty(views.shape, dtype=float, device=device)
        sums = wp.zeros(views.shape, dtype=pixel_type(channels + 2), device=device)
        dim = (last - first, image.shape[0], threads)
        _find_nearest(disparity, some, softness, nearest)
        inputs = [image, disparity, some, nearest, softness, sharpness, threads]
        launch(kernels.sums, dim, inputs, [sums], device=device)
        launch(kernels.means, dim, [sums, threads], [views, coverage], device=device)

    in_slices(device, len(views_out), some_views)


class _OccludingDataTerm:
    """Slices of the views on the cores of a CPU, one view at a time; as many as the cache holds on a GPU."""

    def __init__(
        self,
        shape: Sequence[int],
        offsets: Any,
        scale: float,
        softness: float,
        sharpness: float,
        least_coverage: float,
        loss: int,
        loss_scale: float,
    ) -> None:
        self._count, height, width, self._channels = shape
        device, sums = offsets.device, pixel_type(self._channels + 2)
        self._cuts, self._lanes = slices(device, self._count), 1 if device.is_cpu else width
        most = max(1, _BUFFER // (height * width * 4 * (self._channels + 3)))
        self._batch = 1 if device.is_cpu else min(most, self._count)
        parts = len(self._cuts)
        self._nearest = wp.empty((parts, self._batch, height, width), dtype=float, device=device)
        self._sums = wp.empty((parts, self._batch, height, width), dtype=sums, device=device)
        self._gradients = wp.empty((parts, height, width), dtype=float, device=device)
        self._values = wp.empty((parts, height, self._lanes), dtype=wp.float64, device=device)
        self._pairs, self._softness, self._sharpness = as_offsets(offsets), softness, sharpness
        self._compared = [scale, least_coverage, loss, loss_scale]

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid
        self._kernels = _kernels(self._channels, recorded.dtype._wp_scalar_type_)
        load(image.device, self._kernels.sums, _nearest_kernel)

    def __call__(self, disparity: Any, gradient_out: Any, value_out: Any) -> None:
        self._gradients.zero_()
        self._values.zero_()

        def some_views(k: int, first: int, last: int) -> None:
            for start in range(first, last, self._batch):
                self._add_views(k, start, min(last, start + self._batch), disparity)

        in_slices(disparity.device, self._count, some_views)
        launch_rows(_total_kernel, [self._gradients], gradient_out)
        if disparity.device.is_cpu:
            value_out.numpy()[0] = self._values.numpy().sum()
            return
        parts = self._values.flatten()
        options = {"inputs": [parts], "outputs": [value_out], "block_dim": BLOCK, "device": disparity.device}
        launch_tiles(sum_kernel, dim=[1], **options)

    def _add_views(self, k: int, first: int, last: int, disparity: Any) -> None:
        """Add gradient and value of some views to those of slice `k`."""
        image, device, kernels, threads = self._image, disparity.device, self._kernels, self._lanes
        height, count, pairs = disparity.shape[0], last - first, self._pairs[first:last]
        nearest, sums = self._nearest[k][:count], self._sums[k][:count]
        dim = (count, height, threads)
        _find_nearest(disparity, pairs, self._softness, nearest)
        sums.zero_()
        seen = [image, disparity, pairs, nearest]
        weights = [self._softness, self._sharpness, threads]
        launch(kernels.sums, dim, [*seen, *weights], [sums], device=device)
        inputs = [self._recorded, self._valid, first, *self._compared, threads]
        launch(kernels.residual, dim, inputs, [sums], device=device)
        outputs = [self._gradients[k], self._values[k]]
        launch(kernels.gradient, height * threads, [*seen, sums, *weights], outputs, device=device)


def z_buffered_data_term(
    shape: Sequence[int],
    offsets: Any,
    *,
    scale: float,
    softness: float,
    sharpness: float,
    least_coverage: float,
    loss: Loss,
    loss_scale: float,
) -> DataTerm:
    return _OccludingDataTerm(
        shape, offsets, scale, softness, sharpness, least_coverage, _LOSSES.index(loss), loss_scale
    )


def visible(disparity: Any, offsets: Any, *, tolerance: float, visible_out: Any) -> None:
    threads, pairs, device = lanes(disparity), as_offsets(offsets), disparity.device
    load(device, _nearest_kernel)

    def some_views(_: int, first: int, last: int) -> None:
        some = pairs[first:last]
        nearest = wp.empty((last - first, *disparity.shape), dtype=float, device=device)
        _find_nearest(disparity, some, _ANY_SOFTNESS, nearest)
        inputs = [disparity, some, nearest, _ANY_SOFTNESS, tolerance, threads]
        dim = (last - first, disparity.shape[0], threads)
        launch(_visible_kernel, dim, inputs, [visible_out[first:last]], device=device)

    in_slices(device, len(visible_out), some_views)
