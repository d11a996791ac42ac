"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

from .memory import pixel_type
from .threads import check_size, in_slices, lanes, launch, launch_rows, load, once

wp.set_module_options({"enable_backward": False})

_WARP = 32  # pixels of a block on a GPU


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
        i = wp.tid()
        block = i / wp.static(_WARP * (radius + 1))
        thread = i - block * wp.static(_WARP * (radius + 1))
        dy = thread / wp.static(_WARP)
        lane = thread - dy * wp.static(_WARP)
        columns = (values.shape[1] + wp.static(_WARP - 1)) / wp.static(_WARP)
        y = block / columns
        x = (block - y * columns) * wp.static(_WARP) + lane
        add_pixel(weights, values, y, x, dy, lane, sums_out)

    return operator_kernel


@once
def _half_window(window: int, device: str) -> Any:
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
    kernels, steps, is_mean = _feature_kernels(channels), _half_window(window, device), int(over_patch == "mean")
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
    features = wp.empty((height, width), dtype=pixel_type(3 * channels), device=place)
    distances = wp.empty((len(steps), height, width), dtype=float, device=place)
    color, gradient = 1 / (sigma_color * channels**0.5), 1 / (sigma_gradient * channels**0.5)

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
        _launch_pixels(kernel, [weights, values], window, sums_out)


def nlm_laplacian(weights: Any, values: Any, *, window: int, laplacian_out: Any) -> None:
    if values.device.is_cpu:
        flow = "s[x] += w[x + back] * (h[x] - o[x + dx])"
        _by_rows(_operator("laplacian", flow, 0.0), weights, values, window, laplacian_out)
    else:
        kernel = _gpu_operator("laplacian", "(here - other)", 0.0, window // 2)
        _launch_pixels(kernel, [weights, values], window, laplacian_out)


def _by_rows(kernel: Any, weights: Any, values: Any, window: int, result_out: Any) -> None:
    launch_rows(kernel, [weights, values, _half_window(window, values.device.alias)], result_out)


def _launch_pixels(kernel: Any, inputs: list[Any], window: int, result_out: Any) -> None:
    """Launch a kernel whose blocks have a warp for each row of the half window."""
    (height, width), rows = result_out.shape, window // 2 + 1
    block = rows * _WARP
    dim = height * -(-width // _WARP) * block
    check_size(dim)
    launch(kernel, dim, inputs, [result_out], device=result_out.device, block_dim=block)


# The sums of the ratio are native code like those of the operators. On a CPU a row goes in chunks, whose sums lie on
# the stack.

_RATIO_ROW = """
    constexpr int CHUNK = 128;
    const int height = guide.shape[0], width = guide.shape[1], size = height * width, row = y * width;
    const float* __restrict__ const g = guide.data;
    const float* __restrict__ const a = numerator.data;
    const float* __restrict__ const b = denominator.data;
    const float weaken = 1.f / (support * support);
    for (int begin = 0; begin < width; begin += CHUNK) {
        const int end = wp::min(begin + CHUNK, width);
        float above[CHUNK], below[CHUNK];
        for (int x = begin; x < end; ++x) {
            above[x - begin] = a[row + x];
            below[x - begin] = b[row + x] + floor;
        }
        for (int k = 0; k < steps.shape[0]; ++k)
            for (int sign = 1; sign >= -1; sign -= 2) {
                const int dy = sign * steps.data[k].c[0], dx = sign * steps.data[k].c[1];
                if ((unsigned)(y + dy) >= (unsigned)height) continue;
                const int first = wp::max(begin, -dx), last = wp::min(end, width - dx), other = row + dy * width + dx;
                // Of a pair the second pixel finds the weight at the first.
                const float* __restrict__ const w = weights.data + (size_t)k * size + (sign > 0 ? row : other);
                for (int x = first; x < last; ++x) {
                    const float apart = g[other + x] - g[row + x], v = w[x] / (1.f + apart * apart * weaken);
                    above[x - begin] += v * a[other + x];
                    below[x - begin] += v * (b[other + x] + floor);
                }
            }
        for (int x = begin; x < end; ++x) ratio.data[row + x] = above[x - begin] / below[x - begin];
    }
"""


@wp.func_native(_RATIO_ROW)
def _divide_row(
    weights: wp.array3d(dtype=float),
    guide: wp.array2d(dtype=float),
    numerator: wp.array2d(dtype=float),
    denominator: wp.array2d(dtype=float),
    steps: wp.array(dtype=wp.vec2i),
    support: float,
    floor: float,
    y: int,
    ratio: wp.array2d(dtype=float),
): ...


@wp.kernel
def _ratio_kernel(
    weights: wp.array3d(dtype=float),
    guide: wp.array2d(dtype=float),
    numerator: wp.array2d(dtype=float),
    denominator: wp.array2d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    support: float,
    floor: float,
    row: int,
    lanes: int,
    ratio_out: wp.array2d(dtype=float),
):
    y = row + wp.tid()
    _divide_row(weights, guide, numerator, denominator, half_window, support, floor, y, ratio_out)


_PIXEL_RATIO = """
    // As in the sums of the operators, each warp of a block has one row of the half window.
    __shared__ float above[RADIUS + 1][32], below[RADIUS + 1][32];
    const int height = guide.shape[0], width = guide.shape[1], p = y * width + x;
    const size_t size = (size_t)height * width;
    const float* const g = guide.data;
    const float* const a = numerator.data;
    const float* const b = denominator.data;
    const float weaken = 1.f / (support * support);
    float upper = 0.f, lower = 0.f;
    if (x < width) {
        const float here = g[p];
        auto add = [&](float weight, int q) {
            const float apart = g[q] - here, v = weight / (1.f + apart * apart * weaken);
            upper += v * a[q];
            lower += v * (b[q] + floor);
        };
        const float* w = weights.data + ((long long)dy * (2 * RADIUS + 1) - RADIUS - 1) * (long long)size + p;
    #pragma unroll
        for (int dx = -RADIUS; dx <= RADIUS; ++dx, w += size) {
            if (dy == 0 && dx <= 0) continue;
            const int step = dy * width + dx;
            if (y + dy < height && (unsigned)(x + dx) < (unsigned)width) add(w[0], p + step);
            if (y >= dy && (unsigned)(x - dx) < (unsigned)width) add(w[-step], p - step);
        }
    }
    above[dy][lane] = upper;
    below[dy][lane] = lower;
    __syncthreads();
    if (dy == 0 && x < width) {
        upper = a[p];
        lower = b[p] + floor;
        for (int row = 0; row <= RADIUS; ++row) {
            upper += above[row][lane];
            lower += below[row][lane];
        }
        ratio.data[p] = upper / lower;
    }
"""


@once
def _gpu_ratio(radius: int) -> Any:
    @wp.func_native(_PIXEL_RATIO.replace("RADIUS", str(radius)))
    def divide_pixel(
        weights: wp.array3d(dtype=float),
        guide: wp.array2d(dtype=float),
        numerator: wp.array2d(dtype=float),
        denominator: wp.array2d(dtype=float),
        support: float,
        floor: float,
        y: int,
        x: int,
        dy: int,
        lane: int,
        ratio: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_ratio_{radius}", enable_backward=False)
    def ratio_kernel(
        weights: wp.array3d(dtype=float),
        guide: wp.array2d(dtype=float),
        numerator: wp.array2d(dtype=float),
        denominator: wp.array2d(dtype=float),
        support: float,
        floor: float,
        ratio_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        block = i / wp.static(_WARP * (radius + 1))
        thread = i - block * wp.static(_WARP * (radius + 1))
        dy = thread / wp.static(_WARP)
        lane = thread - dy * wp.static(_WARP)
        columns = (guide.shape[1] + wp.static(_WARP - 1)) / wp.static(_WARP)
        y = block / columns
        x = (block - y * columns) * wp.static(_WARP) + lane
        divide_pixel(weights, guide, numerator, denominator, support, floor, y, x, dy, lane, ratio_out)

    return ratio_kernel


def nlm_ratio(
    weights: Any,
    guide: Any,
    numerator: Any,
    denominator: Any,
    *,
    window: int,
    support: float,
    floor: float,
    ratio_out: Any,
) -> None:
    device, fields = guide.device, [weights, guide, numerator, denominator]
    if device.is_cpu:
        launch_rows(_ratio_kernel, [*fields, _half_window(window, device.alias), support, floor], ratio_out)
    else:
        _launch_pixels(_gpu_ratio(window // 2), [*fields, support, floor], window, ratio_out)


# The plane is a regression about the middle of what counts; its ridge draws slopes to 0 that the window cannot tell.

_PLANE_AT = """
    auto plane_at = [&](float value, const float* s) {
        const float inverse = 1.f / s[0], x = s[1] * inverse, y = s[2] * inverse, middle = s[6] * inverse;
        const float xx = s[3] * inverse - x * x + ridge, xy = s[4] * inverse - x * y;
        const float yy = s[5] * inverse - y * y + ridge;
        const float along_x = s[7] * inverse - x * middle, along_y = s[8] * inverse - y * middle;
        const float determinant = 1.f / (xx * yy - xy * xy);
        const float slope_x = (along_x * yy - along_y * xy) * determinant;
        const float slope_y = (along_y * xx - along_x * xy) * determinant;
        return value + middle - slope_x * x - slope_y * y;
    };
"""

_PLANE_ROW = """
    constexpr int CHUNK = 128;
    const int height = values.shape[0], width = values.shape[1], size = height * width, row = y * width;
    const float* __restrict__ const d = values.data;
    const float* __restrict__ const c = certainty.data;
    const float weaken = 1.f / (support * support);
    for (int begin = 0; begin < width; begin += CHUNK) {
        const int end = wp::min(begin + CHUNK, width);
        float total[CHUNK], sx[CHUNK], sy[CHUNK], sxx[CHUNK], sxy[CHUNK], syy[CHUNK], sd[CHUNK], sxd[CHUNK], syd[CHUNK];
        for (int j = 0; j < end - begin; ++j) {
            total[j] = c[row + begin + j];
            sx[j] = sy[j] = sxx[j] = sxy[j] = syy[j] = sd[j] = sxd[j] = syd[j] = 0.f;
        }
        for (int k = 0; k < steps.shape[0]; ++k)
            for (int sign = 1; sign >= -1; sign -= 2) {
                const int dy = sign * steps.data[k].c[0], dx = sign * steps.data[k].c[1];
                if ((unsigned)(y + dy) >= (unsigned)height) continue;
                const int first = wp::max(begin, -dx), last = wp::min(end, width - dx), other = row + dy * width + dx;
                // Of a pair the second pixel finds the weight at the first.
                const float* __restrict__ const w = weights.data + (size_t)k * size + (sign > 0 ? row : other);
                const float fx = (float)dx, fy = (float)dy;
                #pragma clang loop vectorize(assume_safety)
                for (int x = first; x < last; ++x) {
                    const int j = x - begin;
                    const float apart = d[other + x] - d[row + x];
                    const float u = w[x] * c[other + x] / (1.f + apart * apart * weaken), ud = u * apart;
                    total[j] += u;
                    sx[j] += fx * u;
                    sy[j] += fy * u;
                    sxx[j] += fx * fx * u;
                    sxy[j] += fx * fy * u;
                    syy[j] += fy * fy * u;
                    sd[j] += ud;
                    sxd[j] += fx * ud;
                    syd[j] += fy * ud;
                }
            }
        for (int j = 0; j < end - begin; ++j) {
            const float sums[9] = {total[j], sx[j], sy[j], sxx[j], sxy[j], syy[j], sd[j], sxd[j], syd[j]};
            plane.data[row + begin + j] = plane_at(d[row + begin + j], sums);
        }
    }
"""


@wp.func_native(_PLANE_AT + _PLANE_ROW)
def _plane_row(
    weights: wp.array3d(dtype=float),
    values: wp.array2d(dtype=float),
    certainty: wp.array2d(dtype=float),
    steps: wp.array(dtype=wp.vec2i),
    support: float,
    ridge: float,
    y: int,
    plane: wp.array2d(dtype=float),
): ...


@wp.kernel
def _plane_kernel(
    weights: wp.array3d(dtype=float),
    values: wp.array2d(dtype=float),
    certainty: wp.array2d(dtype=float),
    half_window: wp.array(dtype=wp.vec2i),
    support: float,
    ridge: float,
    row: int,
    lanes: int,
    plane_out: wp.array2d(dtype=float),
):
    y = row + wp.tid()
    _plane_row(weights, values, certainty, half_window, support, ridge, y, plane_out)


_PIXEL_PLANE = """
    // As in the sums of the operators, each warp of a block has one row of the half window.
    __shared__ float parts[RADIUS + 1][9][32];
    const int height = values.shape[0], width = values.shape[1], p = y * width + x;
    const size_t size = (size_t)height * width;
    const float* const d = values.data;
    const float* const c = certainty.data;
    const float weaken = 1.f / (support * support);
    float sums[9] = {};
    if (x < width) {
        const float here = d[p];
        auto add = [&](float weight, int q, float fx, float fy) {
            const float apart = d[q] - here, u = weight * c[q] / (1.f + apart * apart * weaken), ud = u * apart;
            sums[0] += u;
            sums[1] += fx * u;
            sums[2] += fy * u;
            sums[3] += fx * fx * u;
            sums[4] += fx * fy * u;
            sums[5] += fy * fy * u;
            sums[6] += ud;
            sums[7] += fx * ud;
            sums[8] += fy * ud;
        };
        const float* w = weights.data + ((long long)dy * (2 * RADIUS + 1) - RADIUS - 1) * (long long)size + p;
    #pragma unroll
        for (int dx = -RADIUS; dx <= RADIUS; ++dx, w += size) {
            if (dy == 0 && dx <= 0) continue;
            const int step = dy * width + dx;
            if (y + dy < height && (unsigned)(x + dx) < (unsigned)width) add(w[0], p + step, dx, dy);
            if (y >= dy && (unsigned)(x - dx) < (unsigned)width) add(w[-step], p - step, -dx, -dy);
        }
    }
    for (int i = 0; i < 9; ++i) parts[dy][i][lane] = sums[i];
    __syncthreads();
    if (dy == 0 && x < width) {
        sums[0] += c[p];
        for (int row = 1; row <= RADIUS; ++row)
            for (int i = 0; i < 9; ++i) sums[i] += parts[row][i][lane];
        plane.data[p] = plane_at(d[p], sums);
    }
"""


@once
def _gpu_plane(radius: int) -> Any:
    @wp.func_native(_PLANE_AT + _PIXEL_PLANE.replace("RADIUS", str(radius)))
    def plane_pixel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        certainty: wp.array2d(dtype=float),
        support: float,
        ridge: float,
        y: int,
        x: int,
        dy: int,
        lane: int,
        plane: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_nlm_gpu_plane_{radius}", enable_backward=False)
    def plane_kernel(
        weights: wp.array3d(dtype=float),
        values: wp.array2d(dtype=float),
        certainty: wp.array2d(dtype=float),
        support: float,
        ridge: float,
        plane_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        block = i / wp.static(_WARP * (radius + 1))
        thread = i - block * wp.static(_WARP * (radius + 1))
        dy = thread / wp.static(_WARP)
        lane = thread - dy * wp.static(_WARP)
        columns = (values.shape[1] + wp.static(_WARP - 1)) / wp.static(_WARP)
        y = block / columns
        x = (block - y * columns) * wp.static(_WARP) + lane
        plane_pixel(weights, values, certainty, support, ridge, y, x, dy, lane, plane_out)

    return plane_kernel


def nlm_plane(
    weights: Any, values: Any, certainty: Any, *, window: int, support: float, ridge: float, plane_out: Any
) -> None:
    device, fields = values.device, [weights, values, certainty]
    if device.is_cpu:
        launch_rows(_plane_kernel, [*fields, _half_window(window, device.alias), support, ridge], plane_out)
    else:
        _launch_pixels(_gpu_plane(window // 2), [*fields, support, ridge], window, plane_out)


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
    steps = _half_window(window, guide.device.alias)
    launch_rows(_on_surface_kernel, [weights, guide, steps, 1 / support**2], weights_out)
