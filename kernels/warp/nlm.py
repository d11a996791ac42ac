"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from lfgpu.types import half_window

from .memory import pixel_type
from .threads import in_slices, lanes, launch_rows, load, once

wp.set_module_options({"enable_backward": False})


@once
def _feature_kernels(channels: int) -> SimpleNamespace:
    pixel, feature = pixel_type(channels), pixel_type(3 * channels)
    module = f"lfgpu_nlm_{channels}"

    @wp.kernel(module=module, enable_backward=False)
    def features_kernel(
        image: wp.array2d(dtype=pixel),
        color: float,
        gradient: float,
        row: int,
        lanes: int,
        features_out: wp.array2d(dtype=feature),
    ):
        """Colour and its central differences in x and y, times `color` and `gradient`."""
        y, lane = wp.tid()
        y = y + row
        height = image.shape[0]
        width = image.shape[1]
        for x in range(lane, width, lanes):
            here = image[y, x] * color
            across = image[y, wp.min(x + 1, width - 1)] - image[y, wp.max(x - 1, 0)]
            down = image[wp.min(y + 1, height - 1), x] - image[wp.max(y - 1, 0), x]
            f = feature()
            for c in range(wp.static(channels)):
                f[c] = here[c]
                f[c + wp.static(channels)] = 0.5 * gradient * across[c]
                f[c + wp.static(2 * channels)] = 0.5 * gradient * down[c]
            features_out[y, x] = f

    @wp.kernel(module=module, enable_backward=False)
    def distance_kernel(
        features: wp.array2d(dtype=feature),
        half_window: wp.array(dtype=wp.vec2i),
        lanes: int,
        distances_out: wp.array3d(dtype=float),
    ):
        """Squared feature distance of each pixel from its neighbour k; 0 where that lies outside."""
        k, y, lane = wp.tid()
        step = half_window[k]
        for x in range(lane, features.shape[1], lanes):
            qy = y + step[0]
            qx = x + step[1]
            distance = float(0.0)
            if qy < features.shape[0] and qx >= 0 and qx < features.shape[1]:
                distance = wp.length_sq(features[y, x] - features[qy, qx])
            distances_out[k, y, x] = distance

    return SimpleNamespace(features=features_kernel, distance=distance_kernel)


@wp.kernel
def _weight_kernel(
    distances: wp.array3d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    radius: int,
    floor: float,
    lanes: int,
    weights_out: wp.array3d(dtype=float),
):
    """exp(-mean distance over the patch), over those patch pixels that both have; at least `floor`."""
    k, y, lane = wp.tid()
    height = distances.shape[1]
    width = distances.shape[2]
    step = half_window[k]
    top = wp.max(y - radius, 0)
    bottom = wp.min(y + radius, height - 1 - step[0])
    for x in range(lane, width, lanes):
        weight = float(0.0)
        qx = x + step[1]
        if y + step[0] < height and qx >= 0 and qx < width:
            left = wp.max(x - radius, wp.max(0, -step[1]))
            right = wp.min(x + radius, width - 1 - wp.max(0, step[1]))
            total = float(0.0)
            for py in range(top, bottom + 1):
                for px in range(left, right + 1):
                    total = total + distances[k, py, px]
            weight = wp.max(wp.exp(-total / float((bottom - top + 1) * (right - left + 1))), floor)
        weights_out[k, y, x] = weight


# In the two operators the loop over the window is the outer one: what a row adds up stays in cache, and the weights are
# read in the order in which they lie. Of each pair the second pixel finds the weight at the first. The inner loops are
# native code because a CPU runs them seven times as fast when it is told that the rows do not overlap.

_ROW_LOOP = """
    const float* __restrict__ w = weight.data;
    const float* __restrict__ h = here.data;
    const float* __restrict__ o = other.data;
    float* __restrict__ s = sums.data;
    const int first = dx < 0 ? -dx : 0;
    const int last = dx < 0 ? here.shape[0] : here.shape[0] - dx;
    if (lanes == 1)
        for (int x = first; x < last; ++x) TERM;
    else if (lane >= first && lane < last)
        for (int x = lane; x < last; x += lanes) TERM;
"""


@once
def _operator(name: str, term: str, keep: float) -> Any:
    """The kernel that starts from `keep` times the values and adds `term` for each pixel of the window."""

    @wp.func_native(_ROW_LOOP.replace("TERM", term))
    def add_row(
        weight: wp.array(dtype=float),
        here: wp.array(dtype=float),
        other: wp.array(dtype=float),
        dx: int,
        back: int,
        lane: int,
        lanes: int,
        sums: wp.array(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_{name}", enable_backward=False)
    def operator_kernel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        half_window: wp.array(dtype=wp.vec2i),
        row: int,
        lanes: int,
        sums_out: wp.array2d(dtype=float),
    ):
        y, lane = wp.tid()
        y = y + row
        for x in range(lane, values.shape[1], lanes):
            sums_out[y, x] = wp.static(keep) * values[y, x]
        for k in range(half_window.shape[0]):
            dy = half_window[k][0]
            dx = half_window[k][1]
            if y + dy < values.shape[0]:
                add_row(weights[k, y], values[y], values[y + dy], dx, 0, lane, lanes, sums_out[y])
            if y - dy >= 0:
                add_row(weights[k, y - dy], values[y], values[y - dy], -dx, -dx, lane, lanes, sums_out[y])

    return operator_kernel


@once
def _half_window(window: int, device: str) -> Any:
    return wp.array(half_window(window).astype(np.int32), dtype=wp.vec2i, device=device)


def nlm_weights(
    image: Any,
    *,
    window: int,
    patch: int,
    sigma_color: float,
    sigma_gradient: float,
    floor: float,
    scratch_out: Any,
    weights_out: Any,
) -> None:
    device, threads, channels = image.device, lanes(image), image.dtype._length_
    kernels = _feature_kernels(channels)
    steps = _half_window(window, device.alias)
    features = wp.empty(image.shape, dtype=pixel_type(3 * channels), device=device)
    color, gradient = 1 / (sigma_color * channels**0.5), 1 / (sigma_gradient * channels**0.5)
    launch_rows(kernels.features, [image, color, gradient], features)
    load(device, kernels.distance, _weight_kernel)

    def some_neighbors(_: int, first: int, last: int) -> None:
        some, distances, dim = steps[first:last], scratch_out[first:last], (last - first, image.shape[0], threads)
        wp.launch(kernels.distance, dim, [features, some, threads], [distances], device=device)
        inputs = [distances, some, patch // 2, floor, threads]
        wp.launch(_weight_kernel, dim, inputs, [weights_out[first:last]], device=device)

    in_slices(device, weights_out.shape[0], some_neighbors)


def nlm_neighbors(weights: Any, values: Any, *, window: int, sums_out: Any) -> None:
    _apply(_operator("neighbors", "s[x] += w[x + back] * o[x + dx]", 1.0), weights, values, window, sums_out)


def nlm_laplacian(weights: Any, values: Any, *, window: int, laplacian_out: Any) -> None:
    flow = "s[x] += w[x + back] * (h[x] - o[x + dx])"
    _apply(_operator("laplacian", flow, 0.0), weights, values, window, laplacian_out)


def _apply(kernel: Any, weights: Any, values: Any, window: int, result_out: Any) -> None:
    launch_rows(kernel, [weights, values, _half_window(window, values.device.alias)], result_out)
