"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which.

`cpu_nlm.py` has the weights of a CPU, but for gradients of whole patches.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

from .cost_volume import code
from .cpu_nlm import CpuWeights
from .memory import pixel_type
from .threads import check_size, in_slices, lanes, launch, launch_rows, load, once

wp.set_module_options({"enable_backward": False})

WARP = 32  # pixels of a block on a GPU
_TILE = (8, 32)  # rows and columns of pixels of a block that finds weights


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

    return SimpleNamespace(features=features_kernel, patch_weight=patch_weight_kernel)


# A block of a GPU has a tile of pixels and one neighbour of each. The distances stay in memory that the block shares.

_WEIGH_TILE = """
    __shared__ float distances[ROWS + 2 * RADIUS][COLUMNS + 2 * RADIUS];
    const int height = features.shape[0], width = features.shape[1];
    const int dy = half_window.data[k].c[0], dx = half_window.data[k].c[1];
    const int wide = COLUMNS + 2 * RADIUS;
    for (int i = thread; i < (ROWS + 2 * RADIUS) * wide; i += ROWS * COLUMNS) {
        const int y = top + i / wide - RADIUS, x = left + i % wide - RADIUS;
        float distance = 0.f;
        if (y >= 0 && y + dy < height && x >= 0 && x < width && x + dx >= 0 && x + dx < width) {
            const auto& here = features.data[y * width + x];
            const auto& there = features.data[(y + dy) * width + x + dx];
            for (int c = 0; c < FEATURES; ++c) {
                const float apart = here.c[c] - there.c[c];
                distance += apart * apart;
            }
        }
        distances[i / wide][i % wide] = distance;
    }
    __syncthreads();
    const int row = thread / COLUMNS, column = thread % COLUMNS, y = top + row, x = left + column;
    if (y >= height || x >= width) return;
    float weight = 0.f;
    if (y + dy < height && x + dx >= 0 && x + dx < width) {
        float total = 0.f;
        for (int j = 0; j <= 2 * RADIUS; ++j)
            for (int i = 0; i <= 2 * RADIUS; ++i) total += distances[row + j][column + i];
        const int rows = min(y + RADIUS, height - 1 - dy) - max(y - RADIUS, 0) + 1;
        const int columns = min(x + RADIUS, width - 1 - max(0, dx)) - max(x - RADIUS, max(0, -dx)) + 1;
        if (is_mean) total /= (float)(rows * columns);
        weight = fmaxf(expf(-total), floor);
    }
    weights.data[((size_t)k * height + y) * width + x] = weight;
"""


@once
def _tile_kernel(channels: int, radius: int) -> Any:
    feature = pixel_type(3 * channels)
    numbers = {"ROWS": _TILE[0], "COLUMNS": _TILE[1], "RADIUS": radius, "FEATURES": 3 * channels}

    @wp.func_native(code(_WEIGH_TILE, **numbers))
    def weigh_tile(
        features: wp.array2d(dtype=feature),
        half_window: wp.array(dtype=wp.vec2i),
        k: int,
        top: int,
        left: int,
        thread: int,
        floor: float,
        is_mean: int,
        weights: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_weights_{channels}_{radius}", enable_backward=False)
    def tile_kernel(
        features: wp.array2d(dtype=feature),
        half_window: wp.array(dtype=wp.vec2i),
        floor: float,
        is_mean: int,
        weights_out: wp.array3d(dtype=float),
    ):
        i = wp.tid()
        block = i / wp.static(_TILE[0] * _TILE[1])
        thread = i - block * wp.static(_TILE[0] * _TILE[1])
        rows = (features.shape[0] + wp.static(_TILE[0] - 1)) / wp.static(_TILE[0])
        columns = (features.shape[1] + wp.static(_TILE[1] - 1)) / wp.static(_TILE[1])
        k = block / (rows * columns)
        tile = block - k * rows * columns
        top = tile / columns * wp.static(_TILE[0])
        left = tile % columns * wp.static(_TILE[1])
        weigh_tile(features, half_window, k, top, left, thread, floor, is_mean, weights_out)

    return tile_kernel


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
    """The CPU's kernel that starts from `keep` and the diagonal times the values and adds `term` for each neighbour."""

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
        diagonal: wp.array2d(dtype=float),
        half_window: wp.array(dtype=wp.vec2i),
        row: int,
        lanes: int,
        sums_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        for x in range(lane, values.shape[1], lanes):
            kept = wp.static(keep)
            if diagonal:
                kept = kept + diagonal[y, x]
            sums_out[y, x] = kept * values[y, x]
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
        total = (diagonal.data ? KEEP + diagonal.data[p] : KEEP) * values.data[p];
        for (int row = 0; row <= RADIUS; ++row) total += parts[row][lane];
        sums.data[p] = total;
    }
"""


@once
def _gpu_operator(name: str, term: str, keep: float, radius: int) -> Any:
    """The same for a GPU: several threads for each pixel."""

    @wp.func_native(code(_PIXEL_SUM, TERM=term, KEEP=f"{keep}f", RADIUS=radius))
    def add_pixel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        diagonal: wp.array2d(dtype=float),
        y: int,
        x: int,
        dy: int,
        lane: int,
        sums: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_{name}_{radius}", enable_backward=False)
    def operator_kernel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        diagonal: wp.array2d(dtype=float),
        sums_out: wp.array2d(dtype=float),
    ):
        y, x, dy, lane = place_in_block(wp.tid(), wp.static(radius + 1), values.shape[1])
        add_pixel(weights, values, diagonal, y, x, dy, lane, sums_out)

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
    block = _TILE[0] * _TILE[1]
    threads = len(steps) * -(-height // _TILE[0]) * -(-width // _TILE[1]) * block
    check_size(threads)

    def weigh(image: Any, weights_out: Any) -> None:
        launch_rows(kernels.features, [image, color, gradient], features)
        inputs = [features, steps, floor, is_mean]
        launch(_tile_kernel(channels, patch // 2), threads, inputs, [weights_out], device=place, block_dim=block)

    return weigh


def nlm_neighbors(weights: Any, values: Any, *, window: int, sums_out: Any) -> None:
    if values.device.is_cpu:
        _by_rows(
            _operator("neighbors", "s[x] += w[x + back] * o[x + dx]", 1.0), weights, values, None, window, sums_out
        )
    else:
        kernel = _gpu_operator("neighbors", "other", 1.0, window // 2)
        launch_pixels(kernel, [weights, values, None], window, sums_out)


def nlm_laplacian(weights: Any, values: Any, *, window: int, laplacian_out: Any, diagonal: Any | None = None) -> None:
    if values.device.is_cpu:
        flow = "s[x] += w[x + back] * (h[x] - o[x + dx])"
        _by_rows(_operator("laplacian", flow, 0.0), weights, values, diagonal, window, laplacian_out)
    else:
        kernel = _gpu_operator("laplacian", "(here - other)", 0.0, window // 2)
        launch_pixels(kernel, [weights, values, diagonal], window, laplacian_out)


def _by_rows(kernel: Any, weights: Any, values: Any, diagonal: Any, window: int, result_out: Any) -> None:
    launch_rows(kernel, [weights, values, diagonal, window_on(window, values.device.alias)], result_out)


def launch_pixels(kernel: Any, inputs: list[Any], window: int, result_out: Any) -> None:
    """Launch a kernel whose blocks have a warp for each row of the half window."""
    (height, width), rows = result_out.shape, window // 2 + 1
    block = rows * WARP
    dim = height * -(-width // WARP) * block
    check_size(dim)
    launch(kernel, dim, inputs, [result_out], device=result_out.device, block_dim=block)
