"""The forward splat, and the data term that is made of it on a CPU."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import warp as wp

from lfgpu.contract import DataTerm

from .gpu_data_term import GpuDataTerm, curvature, curvature_factor
from .memory import pixel_type
from .pixels import Field, Volume, pixelwise
from .threads import in_slices, launch, load, once, slices


@wp.func
def tent(a: float, softness: float) -> float:
    """Λ(a) for a in [0, 1], as 1 minus the integral of -Λ': without branches, which random fractions mispredict."""
    top = wp.min(a, softness)
    foot = wp.max(a - (1.0 - softness), 0.0)
    return 1.0 - (a - top + (top * top - foot * foot) * (0.5 / softness)) * (1.0 / (1.0 - softness))


@wp.func
def tent_slope(a: float, softness: float) -> float:
    """Λ'(a) for a in [0, 1]."""
    return -(1.0 / (1.0 - softness)) * wp.min(wp.min(a, 1.0 - a) * (1.0 / softness), 1.0)


@wp.func
def foot(b: float, softness: float) -> float:
    """Λ(1 - b) for b in [0, 1], with all its digits where it is nearly 0."""
    low = wp.min(b, softness)
    top = wp.max(b - (1.0 - softness), 0.0)
    return (b - low + (low * low - top * top) * (0.5 / softness)) * (1.0 / (1.0 - softness))


@wp.struct
class Landing:
    """The landing place of a reference pixel in a view: the pixel above and to the left, and the rest beyond it."""

    x: wp.int32
    y: wp.int32
    ax: wp.float32
    ay: wp.float32


@wp.func
def land(x: int, y: int, disparity: float, offset: wp.vec2f) -> Landing:
    # The shift is split before the column is added: a small number keeps its digits in float32.
    shift_x = -disparity * offset[0]
    shift_y = -disparity * offset[1]
    whole_x = wp.floor(shift_x)
    whole_y = wp.floor(shift_y)
    landing = Landing()
    landing.x = x + int(whole_x)
    landing.y = y + int(whole_y)
    landing.ax = shift_x - whole_x
    landing.ay = shift_y - whole_y
    return landing


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    """Return the kernels for pixels of `channels` values; recorded views are of scalar type `stored`."""
    pixel = pixel_type(channels)
    stored_pixel = pixel_type(channels, stored)
    module = f"lfgpu_splat_{channels}_{stored.__name__}"

    @wp.func
    def inside(to: Landing, height: int, width: int) -> bool:
        """True if all four taps lie in the frame: the common case, for which one test is enough."""
        return to.x >= 0 and to.x < width - 1 and to.y >= 0 and to.y < height - 1

    @wp.func
    def add(image: wp.array3d(dtype=pixel), n: int, y: int, x: int, value: pixel):
        if x >= 0 and x < image.shape[2] and y >= 0 and y < image.shape[1]:
            wp.atomic_add(image, n, y, x, value)

    @wp.func
    def at(image: wp.array3d(dtype=pixel), n: int, y: int, x: int) -> pixel:
        value = pixel()
        if x >= 0 and x < image.shape[2] and y >= 0 and y < image.shape[1]:
            value = image[n, y, x]
        return value

    @wp.kernel(module=module, enable_backward=False)
    def splat_kernel(
        image: wp.array2d(dtype=pixel),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        softness: float,
        lanes: int,
        views_out: wp.array3d(dtype=pixel),
    ):
        n, y, lane = wp.tid()
        offset = offsets[n]
        for x in range(lane, image.shape[1], lanes):
            to = land(x, y, disparity[y, x], offset)
            wx = tent(to.ax, softness)
            wy = tent(to.ay, softness)
            left = image[y, x] * wx
            right = image[y, x] * (1.0 - wx)
            if inside(to, views_out.shape[1], views_out.shape[2]):
                wp.atomic_add(views_out, n, to.y, to.x, left * wy)
                wp.atomic_add(views_out, n, to.y, to.x + 1, right * wy)
                wp.atomic_add(views_out, n, to.y + 1, to.x, left * (1.0 - wy))
                wp.atomic_add(views_out, n, to.y + 1, to.x + 1, right * (1.0 - wy))
            else:
                add(views_out, n, to.y, to.x, left * wy)
                add(views_out, n, to.y, to.x + 1, right * wy)
                add(views_out, n, to.y + 1, to.x, left * (1.0 - wy))
                add(views_out, n, to.y + 1, to.x + 1, right * (1.0 - wy))

    @wp.kernel(module=module, enable_backward=False)
    def vjp_kernel(
        image: wp.array2d(dtype=pixel),
        disparity: wp.array2d(dtype=float),
        residual: wp.array3d(dtype=pixel),
        offsets: wp.array(dtype=wp.vec2f),
        factor: float,
        softness: float,
        row: int,
        lanes: int,
        gradient_out: wp.array2d(dtype=float),
    ):
        """Adds factor * Jᵀ r, so that views can come in batches."""
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        for x in range(lane, image.shape[1], lanes):
            d = disparity[y, x]
            value = image[y, x]
            total = float(0.0)
            for n in range(offsets.shape[0]):
                offset = offsets[n]
                to = land(x, y, d, offset)
                wx = tent(to.ax, softness)
                wy = tent(to.ay, softness)
                sx = -offset[0] * tent_slope(to.ax, softness)
                sy = -offset[1] * tent_slope(to.ay, softness)
                r00 = pixel()
                r01 = pixel()
                r10 = pixel()
                r11 = pixel()
                if inside(to, residual.shape[1], residual.shape[2]):
                    r00 = residual[n, to.y, to.x]
                    r01 = residual[n, to.y, to.x + 1]
                    r10 = residual[n, to.y + 1, to.x]
                    r11 = residual[n, to.y + 1, to.x + 1]
                else:
                    r00 = at(residual, n, to.y, to.x)
                    r01 = at(residual, n, to.y, to.x + 1)
                    r10 = at(residual, n, to.y + 1, to.x)
                    r11 = at(residual, n, to.y + 1, to.x + 1)
                a00 = wp.dot(value, r00)
                a01 = wp.dot(value, r01)
                a10 = wp.dot(value, r10)
                a11 = wp.dot(value, r11)
                total = total + sx * (wy * (a00 - a01) + (1.0 - wy) * (a10 - a11))
                total = total + sy * (wx * (a00 - a10) + (1.0 - wx) * (a01 - a11))
            gradient_out[y, x] = gradient_out[y, x] + factor * total

    @wp.kernel(module=module, enable_backward=False)
    def residual_kernel(
        recorded: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        first: int,
        scale: float,
        lanes: int,
        views_out: wp.array3d(dtype=pixel),
        squares_out: wp.array2d(dtype=float),
    ):
        """Turns predicted views into residuals and adds up their squares row by row; 0 where not valid."""
        n, y, lane = wp.tid()
        total = float(0.0)
        for x in range(lane, views_out.shape[2], lanes):
            value = views_out[n, y, x]
            stored_value = recorded[first + n, y, x]
            for c in range(wp.static(channels)):
                value[c] = value[c] - scale * float(stored_value[c])
            if valid and valid[first + n, y, x] == 0.0:
                value = pixel()
            views_out[n, y, x] = value
            total = total + wp.dot(value, value)
        wp.atomic_add(squares_out, first + n, y, total)

    return SimpleNamespace(splat=splat_kernel, vjp=vjp_kernel, residual=residual_kernel)


@pixelwise("lfgpu_splat_total")
def _add_up(y: int, x: int, gradients: Volume, gradient_out: Field):
    total = float(0.0)
    for k in range(gradients.shape[0]):
        total = total + gradients[k, y, x]
    gradient_out[y, x] = total


def as_offsets(offsets: Any) -> Any:
    """Return a field [n, 2] as an array of vectors, without a copy."""
    return offsets.view(wp.vec2f)


@pixelwise("lfgpu_seen")
def seen_by_reference(
    n: int, y: int, x: int, disparity: Field, offsets: Field, known: Field, valid: Volume, seen_out: Volume
):
    from_x = float(x) + disparity[y, x] * offsets[n, 0]
    from_y = float(y) + disparity[y, x] * offsets[n, 1]
    right = float(disparity.shape[1] - 1)
    bottom = float(disparity.shape[0] - 1)
    seen = from_x >= 0.0 and from_x <= right and from_y >= 0.0 and from_y <= bottom
    if seen and known:
        seen = known[int(wp.rint(from_y)), int(wp.rint(from_x))] != 0.0
    if valid and valid[n, y, x] == 0.0:
        seen = False
    seen_out[n, y, x] = wp.where(seen, 1.0, 0.0)


class _CpuDataTerm:
    """Slices of the views on the cores; one view at a time keeps the prediction in a core's cache."""

    def __init__(self, shape: Sequence[int], offsets: Any, scale: float, softness: float) -> None:
        n, height, width, channels = shape
        self._cuts = slices(offsets.device, n)
        pixel, parts = pixel_type(channels), len(self._cuts)
        self._residuals = wp.empty((parts, 1, height, width), dtype=pixel, device=offsets.device)
        self._gradients = wp.zeros((parts, height, width), dtype=float, device=offsets.device)
        self._squares = wp.zeros((n, height), dtype=float, device=offsets.device)
        self._pairs, self._scale, self._softness, self._channels = as_offsets(offsets), scale, softness, channels
        self._curvature = curvature_factor(offsets)

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid
        self._kernels = _kernels(self._channels, recorded.dtype._wp_scalar_type_)
        load(image.device, self._kernels.splat)

    def __call__(self, disparity: Any, gradient_out: Any, value_out: Any) -> None:
        image, device, softness = self._image, disparity.device, self._softness
        dim = (1, disparity.shape[0], 1)

        def some_views(k: int, first: int, last: int) -> None:
            residual, gradient = self._residuals[k], self._gradients[k]
            for n in range(first, last):
                pair = self._pairs[n : n + 1]
                residual.zero_()
                inputs = [image, disparity, pair, softness, 1]
                launch(self._kernels.splat, dim, inputs, [residual], device=device)
                inputs = [self._recorded, self._valid, n, self._scale, 1]
                launch(self._kernels.residual, dim, inputs, [residual, self._squares], device=device)
                inputs = [image, disparity, residual, pair, 2.0, softness, 0, 1]
                launch(self._kernels.vjp, disparity.shape[0], inputs, [gradient], device=device)

        self._gradients.zero_()
        self._squares.zero_()
        in_slices(device, len(self._squares), some_views)
        _add_up(self._gradients, gradient_out)
        value_out.numpy()[0] = self._squares.numpy().sum(dtype="float64")

    def curvature(self, curvature_out: Any) -> None:
        curvature(self._image, self._curvature, curvature_out)


def data_term(shape: Sequence[int], offsets: Any, *, scale: float, softness: float) -> DataTerm:
    kind = _CpuDataTerm if offsets.device.is_cpu else GpuDataTerm
    return kind(shape, offsets, scale, softness)
