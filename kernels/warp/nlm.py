"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which.

`cpu_nlm.py` has the weights of a CPU, but for gradients of whole patches.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

from .cpu_nlm import CpuWeights
from .memory import pixel_type
from .threads import check_size, in_slices, lanes, launch, launch_rows, load, once

wp.set_module_options({"enable_backward": False})

WARP = 32  # pixels of a block on a GPU


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
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
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

    @wp.kernel(module=module, enable_backward=False)
    def patch_weight_kernel(
        image: wp.array2d(dtype=pixel),
        half_window: wp.array(dtype=wp.vec2i),
        radius: int,
        color: float,
        gradient: float,
        floor: float,
        is_mean: int,
        lanes: int,
        weights_out: wp.array3d(dtype=float),
    ):
        """Weights whose gradients are the differences between the patch pixels and the middle of the patch."""
        k, y, lane = wp.tid()
        height = image.shape[0]
        width = image.shape[1]
        step = half_window[k]
        top = wp.max(y - radius, 0)
        bottom = wp.min(y + radius, height - 1 - step[0])
        for x in range(lane, width, lanes):
            weight = float(0.0)
            qx = x + step[1]
            if y + step[0] < height and qx >= 0 and qx < width:
                left = wp.max(x - radius, wp.max(0, -step[1]))
                right = wp.min(x + radius, width - 1 - wp.max(0, step[1]))
                middle = image[y, x] - image[y + step[0], qx]
                total = float(0.0)
                for py in range(top, bottom + 1):
                    for px in range(left, right + 1):
                        apart = image[py, px] - image[py + step[0], px + step[1]]
                        total = total + color * wp.length_sq(apart) + gradient * wp.length_sq(middle - apart)
                if is_mean == 1:
                    total = total / float((bottom - top + 1) * (right - left + 1))
                weight = wp.max(wp.exp(-total), floor)
            weights_out[k, y, x] = weight

    return SimpleNamespace(features=features_kernel, distance=distance_kernel, patch_weight=patch_weight_kernel)


@wp.kernel
def _weight_kernel(
    distances: wp.array3d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    radius: int,
    floor: float,
    is_mean: int,
    lanes: int,
    weights_out: wp.array3d(dtype=float),
):
    """exp(-distance), the mean or the sum over those patch pixels that both have; at least `floor`."""
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
            if is_mean == 1:
                total = total / float((bottom - top + 1) * (right - left + 1))
            weight = wp.max(wp.exp(-total), floor)
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
    for (int x = first; x < last; ++x) TERM;
"""


@once
def _operator(name: str, term: str, keep: float) -> Any:
    """The CPU's kernel that starts from `keep` times the values and adds `term` for each pixel of the window."""

    @wp.func_native(_ROW_LOOP.replace("TERM", term))
    def add_row(
        weight: wp.array(dtype=float),
        here: wp.array(dtype=float),
        other: wp.array(dtype=float),
        dx: int,
        back: int,
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
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        for x in range(lane, values.shape[1], lanes):
            sums_out[y, x] = wp.static(keep) * values[y, x]
        for k in range(half_window.shape[0]):
            dy = half_window[k][0]
            dx = half_window[k][1]
            if y + dy < values.shape[0]:
                add_row(weights[k, y], values[y], values[y + dy], dx, 0, sums_out[y])
            if y - dy >= 0:
                add_row(weights[k, y - dy], values[y], values[y - dy], -dx, -dx, sums_out[y])

    return operator_kernel


@wp.func
def place_in_block(i: int, rows: int, width: int):
    """(y, x, row of the half window, lane) of a thread: a block has a warp for each row of the half window."""
    block = i / (wp.static(WARP) * rows)
    thread = i - block * wp.static(WARP) * rows
    dy = thread / wp.static(WARP)
    lane = thread - dy * wp.static(WARP)
    columns = (width + wp.static(WARP - 1)) / wp.static(WARP)
    y = block / columns
    return y, (block - y * columns) * wp.static(WARP) + lane, dy, lane


_PIXEL_SUM = """
    // The warps of a block have the same 32 pixels, and each one row of the half window.
    __shared__ float parts[RADIUS + 1][32];
    const int height = values.shape[0], width = values.shape[1], p = y * width + x;
    const size_t size = (size_t)height * width;
    float total = 0.f;
    if (x < width) {
        const float here = values.data[p];
        const bool below = y + dy < height, above = y >= dy, inner = x >= RADIUS && x < width - RADIUS;
        const float* const down = values.data + p + dy * width;
        const float* const up = values.data + p - dy * width;
        // Of the row's first neighbour, dx = -RADIUS; the centre row begins at dx = 1, which is neighbour 0.
        const float* const w = weights.data + ((long long)dy * (2 * RADIUS + 1) - RADIUS - 1) * (long long)size + p;
        auto add = [&](float weight, float other) { total += weight * TERM; };
        if (below && above && inner && dy > 0) {  // nearly all; with nothing to decide, all reads are under way at once
    #pragma unroll
            for (int dx = -RADIUS; dx <= RADIUS; ++dx) {
                const float* const at = w + (dx + RADIUS) * size;
                add(at[0], down[dx]);
                add(at[-dy * width - dx], up[-dx]);
            }
        } else {
    #pragma unroll
            for (int dx = -RADIUS; dx <= RADIUS; ++dx) {
                if (dy == 0 && dx <= 0) continue;
                const float* const at = w + (dx + RADIUS) * size;
                if (below && (inner || (unsigned)(x + dx) < (unsigned)width)) add(at[0], down[dx]);
                if (above && (inner || (unsigned)(x - dx) < (unsigned)width)) add(at[-dy * width - dx], up[-dx]);
            }
        }
    }
    parts[dy][lane] = total;
    __syncthreads();
    if (dy == 0 && x < width) {
        total = KEEP * values.data[p];
        for (int row = 0; row <= RADIUS; ++row) total += parts[row][lane];
        sums.data[p] = total;
    }
"""


@once
def _gpu_operator(name: str, term: str, keep: float, radius: int) -> Any:
    """The same for a GPU: several threads for each pixel."""
    code = _PIXEL_SUM.replace("TERM", term).replace("KEEP", f"{keep}f").replace("RADIUS", str(radius))

    @wp.func_native(code)
    def add_pixel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        y: int,
        x: int,
        dy: int,
        lane: int,
        sums: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_{name}_{radius}", enable_backward=False)
    def operator_kernel(
        weights: wp.array3d(dtype=float), values: wp.array2d(dtype=float), sums_out: wp.array2d(dtype=float)
    ):
        y, x, dy, lane = place_in_block(wp.tid(), wp.static(radius + 1), values.shape[1])
        add_pixel(weights, values, y, x, dy, lane, sums_out)

    return operator_kernel


@once
def window_on(window: int, device: str) -> Any:
    return wp.array(half_window(window).astype(np.int32), dtype=wp.vec2i, device=device)


def nlm_weights(
    shape: Sequence[int],
    device: str,
    *,
    window: int,
    patch: int,
    sigma_color: float,
    sigma_gradient: float,
    floor: float,
    over_patch: OverPatch = "mean",
    gradients: PatchGradients = "central",
) -> NlmWeights:
    (height, width, channels), place = shape, wp.get_device(device)
    kernels, steps, is_mean = _feature_kernels(channels), window_on(window, device), int(over_patch == "mean")
    if gradients == "patch":
        factors = [1 / (sigma**2 * channels) for sigma in (sigma_color, sigma_gradient)]

        def weigh_by_patches(image: Any, weights_out: Any) -> None:
            threads = lanes(image)
            load(place, kernels.patch_weight)

            def some_neighbors(_: int, first: int, last: int) -> None:
                inputs = [image, steps[first:last], patch // 2, *factors, floor, is_mean, threads]
                dim = (last - first, height, threads)
                launch(kernels.patch_weight, dim, inputs, [weights_out[first:last]], device=place)

            in_slices(place, len(steps), some_neighbors)

        return weigh_by_patches
    color, gradient = 1 / (sigma_color * channels**0.5), 1 / (sigma_gradient * channels**0.5)
    if place.is_cpu:
        return CpuWeights(
            (height, width, channels),
            steps,
            patch=patch,
            color=color,
            gradient=gradient,
            floor=floor,
            is_mean=is_mean == 1,
        )
    features = wp.empty((height, width), dtype=pixel_type(3 * channels), device=place)
    distances = wp.empty((len(steps), height, width), dtype=float, device=place)

    def weigh(image: Any, weights_out: Any) -> None:
        threads = lanes(image)
        launch_rows(kernels.features, [image, color, gradient], features)
        load(place, kernels.distance, _weight_kernel)

        def some_neighbors(_: int, first: int, last: int) -> None:
            some, room, dim = steps[first:last], distances[first:last], (last - first, height, threads)
            launch(kernels.distance, dim, [features, some, threads], [room], device=place)
            inputs = [room, some, patch // 2, floor, is_mean, threads]
            launch(_weight_kernel, dim, inputs, [weights_out[first:last]], device=place)

        in_slices(place, len(steps), some_neighbors)

    return weigh


def nlm_neighbors(weights: Any, values: Any, *, window: int, sums_out: Any) -> None:
    if values.device.is_cpu:
        _by_rows(_operator("neighbors", "s[x] += w[x + back] * o[x + dx]", 1.0), weights, values, window, sums_out)
    else:
        kernel = _gpu_operator("neighbors", "other", 1.0, window // 2)
        launch_pixels(kernel, [weights, values], window, sums_out)


def nlm_laplacian(weights: Any, values: Any, *, window: int, laplacian_out: Any) -> None:
    if values.device.is_cpu:
        flow = "s[x] += w[x + back] * (h[x] - o[x + dx])"
        _by_rows(_operator("laplacian", flow, 0.0), weights, values, window, laplacian_out)
    else:
        kernel = _gpu_operator("laplacian", "(here - other)", 0.0, window // 2)
        launch_pixels(kernel, [weights, values], window, laplacian_out)


def _by_rows(kernel: Any, weights: Any, values: Any, window: int, result_out: Any) -> None:
    launch_rows(kernel, [weights, values, window_on(window, values.device.alias)], result_out)


def launch_pixels(kernel: Any, inputs: list[Any], window: int, result_out: Any) -> None:
    """Launch a kernel whose blocks have a warp for each row of the half window."""
    (height, width), rows = result_out.shape, window // 2 + 1
    block = rows * WARP
    dim = height * -(-width // WARP) * block
    check_size(dim)
    launch(kernel, dim, inputs, [result_out], device=result_out.device, block_dim=block)
