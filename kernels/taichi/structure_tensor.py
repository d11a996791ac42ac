"""Structure tensors on sheared epipolar plane images; `kernels/reference/structure_tensor.py` says what they are."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import taichi as ti

from lfgpu.contract import LocalEstimate, StructureFilters

from .memory import DeviceArray, empty, flat, operation
from .runtime import once, run


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    field, image_type = flat(), flat(channels=channels)
    pixel = ti.types.vector(channels, ti.f32)

    @ti.kernel
    def along_kernel(
        epis: flat(stored, channels),
        offsets: field,
        along_value: field,
        along_slope: field,
        scale: float,
        shear: float,
        width: int,
        size: int,
        value_out: image_type,
        slope_out: image_type,
    ):
        """Smoothed value and derivative along the views, of EPIs sheared by linear interpolation."""
        views = offsets.shape[0]
        for i in range(value_out.shape[0]):
            m = i // size
            p = i - m * size
            x = p % width
            value = pixel(0.0)
            slope = pixel(0.0)
            for u in range(views):
                shift = -shear * offsets[u]
                whole = ti.floor(shift)
                share = shift - whole
                left = x + ti.cast(whole, ti.i32)
                row = u * size + p - x
                sample = ti.cast(epis[row + ti.math.clamp(left, 0, width - 1)], ti.f32)
                if share > 0.0:
                    right = ti.cast(epis[row + ti.math.clamp(left + 1, 0, width - 1)], ti.f32)
                    sample = sample * (1.0 - share) + right * share
                value += sample * (scale * along_value[m * views + u])
                slope += sample * (scale * along_slope[m * views + u])
            value_out[i] = value
            slope_out[i] = slope

    @ti.kernel
    def across_kernel(
        value: image_type,
        slope: image_type,
        across_value: field,
        across_slope: field,
        along_outer: field,
        width: int,
        size: int,
        tensor_out: flat(channels=3),
    ):
        """Gradients, and their products summed over channels and the outer window along the views."""
        radius = across_value.shape[0] // 2
        for p in range(size):
            x = p % width
            tensor = ti.Vector([0.0, 0.0, 0.0])
            for m in range(along_outer.shape[0]):
                e_x = pixel(0.0)
                e_u = pixel(0.0)
                for k in range(across_value.shape[0]):
                    i = m * size + p - x + ti.math.clamp(x + k - radius, 0, width - 1)
                    e_x += value[i] * across_slope[k]
                    e_u += slope[i] * across_value[k]
                tensor += ti.Vector([e_x.dot(e_x), e_x.dot(e_u), e_u.dot(e_u)]) * along_outer[m]
            tensor_out[p] = tensor

    return SimpleNamespace(along=along_kernel, across=across_kernel)


@ti.kernel
def _slope_kernel(
    tensor: flat(channels=3),
    across_outer: flat(),
    shear: float,
    floor: float,
    width: int,
    disparity_out: flat(),
    coherence_out: flat(),
):
    """Outer smoothing across the views, then the direction and coherence of the tensor."""
    radius = across_outer.shape[0] // 2
    for p in range(tensor.shape[0]):
        x = p % width
        t = ti.Vector([0.0, 0.0, 0.0])
        for k in range(across_outer.shape[0]):
            t += tensor[p - x + ti.math.clamp(x + k - radius, 0, width - 1)] * across_outer[k]
        difference = t[0] - t[2]
        trace = t[0] + t[2] + floor * floor
        disparity_out[p] = shear + ti.tan(0.5 * ti.atan2(2.0 * t[1], difference))
        coherence_out[p] = (difference * difference + 4.0 * t[1] * t[1]) / (trace * trace)


@operation
@ti.kernel
def keep_more_coherent(
    disparity: flat(),
    coherence: flat(),
    trusted: flat(),
    has_trusted: ti.template(),
    shear: float,
    reach: float,
    unit: float,
    low: float,
    high: float,
    height: int,
    width: int,
    vertical: int,
    best_disparity_out: flat(),
    best_coherence_out: flat(),
):
    for p in range(height * width):
        i = p
        if vertical == 1:
            i = p % width * height + p // width
        value = disparity[i] / unit
        better = coherence[i] > best_coherence_out[p] and ti.abs(disparity[i] - shear) <= reach
        better = better and value >= low and value <= high
        if ti.static(has_trusted):
            better = better and trusted[i] != 0.0
        if better:
            best_disparity_out[p] = value
            best_coherence_out[p] = coherence[i]


def structure_tensor(
    shape: Sequence[int], offsets: DeviceArray, filters: StructureFilters, *, scale: float, floor: float
) -> LocalEstimate:
    (_, height, width, channels), size = shape, shape[1] * shape[2]
    value = empty((filters.along_outer.shape[0], height, width), channels=channels)
    slope = empty(value.shape, channels=channels)
    tensor = empty((height, width), channels=3)

    def evaluate(epis: DeviceArray, shear: float, disparity_out: DeviceArray, coherence_out: DeviceArray) -> None:
        kernels = _kernels(channels, epis.scalar)
        along = filters.along_value, filters.along_slope, scale, shear, width, size
        run(kernels.along, epis, offsets, *along, value, slope)
        across = filters.across_value, filters.across_slope, filters.along_outer, width, size
        run(kernels.across, value, slope, *across, tensor)
        run(_slope_kernel, tensor, filters.across_outer, shear, floor, width, disparity_out, coherence_out)

    return evaluate
