"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

from .memory import pixel_type
from .native_code import function, kernel
from .pixels import pixelwise
from .threads import check_size, in_slices, lanes, launch, launch_rows, load, once, room_for

wp.set_module_options({"enable_backward": False})

WARP = 32  # pixels of a block on a GPU
_TILE = (8, 32)  # rows and columns of pixels of a block that finds weights


@once
def _features(channels: int, planar: bool) -> Any:
    """Return what finds colours and their central differences in x and y, times `color` and `gradient`.

    A CPU keeps them as planes.
    """
    pixel, feature = pixel_type(channels), pixel_type(3 * channels)

    @wp.func
    def features_at(
        image: wp.array2d(dtype=pixel),
        y: int,
        x: int,
        color_given: float,
        sigma: wp.array(dtype=wp.float64),
        root: wp.float64,
        gradient: float,
    ) -> feature:
        color = color_given
        if sigma:
            color = float(wp.float64(1.0) / (sigma[0] * root))
        here = image[y, x] * color
        across = image[y, wp.min(x + 1, image.shape[1] - 1)] - image[y, wp.max(x - 1, 0)]
        down = image[wp.min(y + 1, image.shape[0] - 1), x] - image[wp.max(y - 1, 0), x]
        f = feature()
        for c in range(wp.static(channels)):
            f[c] = here[c]
            f[c + wp.static(channels)] = 0.5 * gradient * across[c]
            f[c + wp.static(2 * channels)] = 0.5 * gradient * down[c]
        return f

    @pixelwise(f"lfgpu_nlm_features_{channels}_{planar:d}")
    def features(
        y: int,
        x: int,
        image: wp.array2d(dtype=pixel),
        color_given: float,
        sigma: wp.array(dtype=wp.float64),
        root: wp.float64,
        gradient: float,
        features_out: wp.array(dtype=float if planar else feature, ndim=3 if planar else 2),
    ):
        found = features_at(image, y, x, color_given, sigma, root, gradient)
        if wp.static(planar):
            for c in range(wp.static(3 * channels)):
                features_out[c, y, x] = found[c]
        else:
            features_out[y, x] = found

    return features


@once
def _patch_weight_kernel(channels: int) -> Any:
    pixel = pixel_type(channels)

    @wp.kernel(module=f"lfgpu_nlm_{channels}", enable_backward=False)
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

    return patch_weight_kernel


def _tile_kernel(channels: int, radius: int) -> Any:
    numbers = {"ROWS": _TILE[0], "COLUMNS": _TILE[1], "RADIUS": radius, "FEATURES": 3 * channels}
    return kernel("nlm.cuh", "weigh_tile", Feature=pixel_type(3 * channels), **numbers)


# In the two operators the loop over the window is the outer one: what a row adds up stays in cache, and the weights are
# read in the order in which they lie.


@once
def _operator(name: str, term: str, keep: float) -> Any:
    """Return the CPU's kernel: `keep` and the diagonal times the values, and `term` for each neighbour."""
    add_neighbor = function("nlm.h", "add_neighbor", TERM=term)

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
                add_neighbor(weights[k, y], values[y], values[y + dy], dx, 0, sums_out[y])
            if y - dy >= 0:
                add_neighbor(weights[k, y - dy], values[y], values[y - dy], -dx, -dx, sums_out[y])

    return operator_kernel


def _gpu_operator(term: str, keep: float, radius: int) -> Any:
    """Return the GPU's kernel: several threads for each pixel."""
    return kernel("nlm.cuh", "add_neighbors", TERM=term, KEEP=keep, RADIUS=radius)


@once
def window_on(window: int, device: str) -> Any:
    return wp.array(half_window(window).astype(np.int32), dtype=wp.vec2i, device=device)


def nlm_weights(
    shape: Sequence[int],
    device: str,
    *,
    window: int,
    patch: int,
    sigma_color: Any,
    sigma_gradient: float,
    floor: float,
    over_patch: OverPatch = "mean",
    gradients: PatchGradients = "central",
) -> NlmWeights:
    (height, width, channels), place = shape, wp.get_device(device)
    steps, is_mean = window_on(window, device), int(over_patch == "mean")
    if gradients == "patch":
        factors = [1 / (sigma**2 * channels) for sigma in (sigma_color, sigma_gradient)]
        by_patches = _patch_weight_kernel(channels)

        def weigh_by_patches(image: Any, weights_out: Any) -> None:
            threads = lanes(image)
            load(place, by_patches)

            def some_neighbors(_: int, first: int, last: int) -> None:
                inputs = [image, steps[first:last], patch // 2, *factors, floor, is_mean, threads]
                dim = (last - first, height, threads)
                launch(by_patches, dim, inputs, [weights_out[first:last]], device=place)

            in_slices(place, len(steps), some_neighbors)

        return weigh_by_patches
    root, gradient = channels**0.5, 1 / (sigma_gradient * channels**0.5)
    color = [0.0, sigma_color, root] if isinstance(sigma_color, wp.array) else [1 / (sigma_color * root), None, root]
    if place.is_cpu:
        on_cpu = kernel("nlm.h", "weigh_neighbors", FEATURES=3 * channels)
        planes = wp.empty((3 * channels, height, width), dtype=float, device=place)
        room = room_for(place, len(steps), width + 2 * (patch // 2) + (1 + patch) * width)

        def weigh_planes(image: Any, weights_out: Any) -> None:
            _features(channels, True)(image, *color, gradient, planes)
            load(place, on_cpu)

            def some_neighbors(part: int, first: int, last: int) -> None:
                inputs = [planes, steps[first:last], patch // 2, floor, is_mean, room[part]]
                launch(on_cpu, 1, inputs, [weights_out[first:last]], device=place)

            in_slices(place, len(steps), some_neighbors)

        return weigh_planes
    features = wp.empty((height, width), dtype=pixel_type(3 * channels), device=place)
    block = _TILE[0] * _TILE[1]
    threads = len(steps) * -(-height // _TILE[0]) * -(-width // _TILE[1]) * block
    check_size(threads)

    def weigh(image: Any, weights_out: Any) -> None:
        _features(channels, False)(image, *color, gradient, features)
        inputs = [features, steps, floor, is_mean]
        launch(_tile_kernel(channels, patch // 2), threads, inputs, [weights_out], device=place, block_dim=block)

    return weigh


def nlm_neighbors(weights: Any, values: Any, *, window: int, sums_out: Any) -> None:
    if values.device.is_cpu:
        _by_rows(
            _operator("neighbors", "s[x] += w[x + back] * o[x + dx]", 1.0), weights, values, None, window, sums_out
        )
    else:
        launch_pixels(_gpu_operator("other", 1.0, window // 2), [weights, values, None], window, sums_out)


def nlm_laplacian(weights: Any, values: Any, *, window: int, laplacian_out: Any, diagonal: Any | None = None) -> None:
    if values.device.is_cpu:
        flow = "s[x] += w[x + back] * (h[x] - o[x + dx])"
        _by_rows(_operator("laplacian", flow, 0.0), weights, values, diagonal, window, laplacian_out)
    else:
        operator = _gpu_operator("(here - other)", 0.0, window // 2)
        launch_pixels(operator, [weights, values, diagonal], window, laplacian_out)


def _by_rows(kernel: Any, weights: Any, values: Any, diagonal: Any, window: int, result_out: Any) -> None:
    launch_rows(kernel, [weights, values, diagonal, window_on(window, values.device.alias)], result_out)


def launch_pixels(kernel: Any, inputs: list[Any], window: int, result_out: Any) -> None:
    """Launch a kernel whose blocks have a warp for each row of the half window."""
    (height, width), rows = result_out.shape, window // 2 + 1
    block = rows * WARP
    dim = height * -(-width // WARP) * block
    check_size(dim)
    launch(kernel, dim, inputs, [result_out], device=result_out.device, block_dim=block)
