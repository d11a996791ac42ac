"""Structure tensors on sheared epipolar plane images; `kernels/reference/structure_tensor.py` says what they are."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import warp as wp

from lfgpu.contract import LocalEstimate, StructureFilters

from .memory import pixel_type
from .pixels import Field, pixelwise
from .threads import once

wp.set_module_options({"enable_backward": False})


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    pixel, stored_pixel = pixel_type(channels), pixel_type(channels, stored)
    module = f"lfgpu_structure_tensor_{channels}_{stored.__name__}"

    @wp.func
    def value_of(epis: wp.array3d(dtype=stored_pixel), u: int, y: int, x: int) -> pixel:
        value = pixel()
        stored_value = epis[u, y, x]
        for c in range(wp.static(channels)):
            value[c] = float(stored_value[c])
        return value

    @pixelwise(f"{module}_along")
    def along(
        n: int,
        y: int,
        x: int,
        epis: wp.array3d(dtype=stored_pixel),
        offsets: wp.array(dtype=float),
        along_value: Field,
        along_slope: Field,
        scale: float,
        shear: float,
        value_out: wp.array3d(dtype=pixel),
        slope_out: wp.array3d(dtype=pixel),
    ):
        """Smoothed value and derivative along the views, of EPIs sheared by linear interpolation."""
        last = epis.shape[2] - 1
        value = pixel()
        slope = pixel()
        for u in range(epis.shape[0]):
            shift = -shear * offsets[u]
            whole = wp.floor(shift)
            share = shift - whole
            left = x + int(whole)
            sample = value_of(epis, u, y, wp.clamp(left, 0, last))
            if share > 0.0:
                sample = sample * (1.0 - share) + value_of(epis, u, y, wp.clamp(left + 1, 0, last)) * share
            value = value + sample * (scale * along_value[n, u])
            slope = slope + sample * (scale * along_slope[n, u])
        value_out[n, y, x] = value
        slope_out[n, y, x] = slope

    @pixelwise(f"{module}_across")
    def across(
        y: int,
        x: int,
        value: wp.array3d(dtype=pixel),
        slope: wp.array3d(dtype=pixel),
        across_value: wp.array(dtype=float),
        across_slope: wp.array(dtype=float),
        along_outer: wp.array(dtype=float),
        tensor_out: wp.array2d(dtype=wp.vec3f),
    ):
        """Gradients, and their products summed over channels and the outer window along the views."""
        last = value.shape[2] - 1
        radius = across_value.shape[0] / 2
        tensor = wp.vec3f()
        for m in range(value.shape[0]):
            e_x = pixel()
            e_u = pixel()
            for k in range(across_value.shape[0]):
                xk = wp.clamp(x + k - radius, 0, last)
                e_x = e_x + value[m, y, xk] * across_slope[k]
                e_u = e_u + slope[m, y, xk] * across_value[k]
            tensor = tensor + wp.vec3f(wp.dot(e_x, e_x), wp.dot(e_x, e_u), wp.dot(e_u, e_u)) * along_outer[m]
        tensor_out[y, x] = tensor

    return SimpleNamespace(along=along, across=across)


@pixelwise("lfgpu_slopes")
def _find_slopes(
    y: int,
    x: int,
    tensor: wp.array2d(dtype=wp.vec3f),
    across_outer: wp.array(dtype=float),
    shear: float,
    floor: float,
    disparity_out: Field,
    coherence_out: Field,
):
    """Outer smoothing across the views, then the direction and coherence of the tensor."""
    last = tensor.shape[1] - 1
    radius = across_outer.shape[0] / 2
    t = wp.vec3f()
    for k in range(across_outer.shape[0]):
        t = t + tensor[y, wp.clamp(x + k - radius, 0, last)] * across_outer[k]
    difference = t[0] - t[2]
    trace = t[0] + t[2] + floor * floor
    disparity_out[y, x] = shear + wp.tan(0.5 * wp.atan2(2.0 * t[1], difference))
    coherence_out[y, x] = (difference * difference + 4.0 * t[1] * t[1]) / (trace * trace)


@pixelwise("lfgpu_keep_more_coherent")
def keep_more_coherent(
    y: int,
    x: int,
    disparity: Field,
    coherence: Field,
    trusted: Field,
    shear: float,
    reach: float,
    unit: float,
    low: float,
    high: float,
    vertical: int,
    best_disparity_out: Field,
    best_coherence_out: Field,
):
    down = wp.where(vertical == 1, x, y)
    across = wp.where(vertical == 1, y, x)
    found = disparity[down, across]
    better = wp.abs(found - shear) <= reach and coherence[down, across] > best_coherence_out[y, x]
    if trusted and trusted[down, across] == 0.0:
        better = False
    found = found / unit
    if better and found >= low and found <= high:
        best_disparity_out[y, x] = found
        best_coherence_out[y, x] = coherence[down, across]


def structure_tensor(
    shape: Sequence[int], offsets: Any, filters: StructureFilters, *, scale: float, floor: float
) -> LocalEstimate:
    (_, height, width, channels), device = shape, offsets.device
    value = wp.empty((filters.along_outer.shape[0], height, width), dtype=pixel_type(channels), device=device)
    slope = wp.empty_like(value)
    tensor = wp.empty((height, width), dtype=wp.vec3f, device=device)

    def evaluate(epis: Any, shear: float, disparity_out: Any, coherence_out: Any) -> None:
        kernels = _kernels(channels, epis.dtype._wp_scalar_type_)
        kernels.along(epis, offsets, filters.along_value, filters.along_slope, scale, shear, value, slope)
        kernels.across(value, slope, filters.across_value, filters.across_slope, filters.along_outer, tensor)
        _find_slopes(tensor, filters.across_outer, shear, floor, disparity_out, coherence_out)

    return evaluate
