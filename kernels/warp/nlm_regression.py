"""Sums with non-local-means weights that also depend on a map: a ratio, a plane; `kernels/reference` says which."""

from typing import Any

import warp as wp

from .native_code import kernel
from .nlm import launch_pixels, window_on
from .threads import launch_rows
from .vector import given

wp.set_module_options({"enable_backward": False})


def _gpu_kernel(name: str, radius: int) -> Any:
    return kernel("nlm.cuh", name, RADIUS=radius)


def nlm_ratio(
    weights: Any,
    guide: Any,
    numerator: Any,
    denominator: Any,
    *,
    window: int,
    support: float,
    floor: Any,
    ratio_out: Any,
) -> None:
    device, fields, numbers = guide.device, [weights, guide, numerator, denominator], [support, *given(floor)]
    if device.is_cpu:
        launch_rows(kernel("nlm.h", "divide_sums"), [*fields, window_on(window, device.alias), *numbers], ratio_out)
    else:
        launch_pixels(_gpu_kernel("divide_sums", window // 2), [*fields, *numbers], window, ratio_out)


def nlm_plane(
    weights: Any, values: Any, certainty: Any, *, window: int, support: float, ridge: float, plane_out: Any
) -> None:
    device, fields = values.device, [weights, values, certainty]
    if device.is_cpu:
        launch_rows(
            kernel("nlm.h", "fit_planes"), [*fields, window_on(window, device.alias), support, ridge], plane_out
        )
    else:
        launch_pixels(_gpu_kernel("fit_planes", window // 2), [*fields, support, ridge], window, plane_out)


@wp.kernel
def _on_surface_kernel(
    weights: wp.array3d(dtype=float),
    guide: wp.array2d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    weaken: float,
    row: int,
    lanes: int,
    weights_out: wp.array3d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    lane = i % lanes
    for k in range(weights.shape[0]):
        step = half_window[k]
        for x in range(lane, guide.shape[1], lanes):
            qy = y + step[0]
            qx = x + step[1]
            weight = float(0.0)
            if qy < guide.shape[0] and qx >= 0 and qx < guide.shape[1]:
                apart = guide[qy, qx] - guide[y, x]
                weight = weights[k, y, x] / (1.0 + apart * apart * weaken)
            weights_out[k, y, x] = weight


def nlm_on_surface(weights: Any, guide: Any, *, window: int, support: float, weights_out: Any) -> None:
    steps = window_on(window, guide.device.alias)
    launch_rows(_on_surface_kernel, [weights, guide, steps, 1 / support**2], weights_out)
