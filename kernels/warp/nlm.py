"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

from .memory import pixel_type
from .native_code import kernel
from .pixels import Volume, pixelwise
from .threads import check_size, launch, launch_rows, launch_slices, once, room_for

wp.set_module_options({"enable_backward": False})

_FILES = "nlm.h", "nlm.cuh"
_WARP = 32  # pixels of a block on a GPU
_TILE = (8, 32)  # rows and columns of pixels of a block that finds weights


@once
def _features(channels: int, planar: bool) -> Any:
    """Return what finds colours and their central differences in x and y, times `color` and `gradient`.

    A CPU keeps them as planes.
    """
    pixel, feature = pixel_type(channels), pixel_type(3 * channels)

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
        if wp.static(planar):
            for c in range(wp.static(3 * channels)):
                features_out[c, y, x] = f[c]
        else:
            features_out[y, x] = f

    return features


@once
def _patch_weights(channels: int) -> Any:
    pixel = pixel_type(channels)

    @pixelwise(f"lfgpu_nlm_{channels}")
    def patch_weights(
        n: int,
        y: int,
        x: int,
        image: wp.array2d(dtype=pixel),
        half_window: wp.array(dtype=wp.vec2i),
        radius: int,
        color: float,
        gradient: float,
        floor: float,
        is_mean: int,
        weights_out: Volume,
    ):
        """Weights whose gradients are the differences between the patch pixels and the middle of the patch."""
        height = image.shape[0]
        width = image.shape[1]
        step = half_window[n]
        weight = float(0.0)
        qx = x + step[1]
        if y + step[0] < height and qx >= 0 and qx < width:
            top = wp.max(y - radius, 0)
            bottom = wp.min(y + radius, height - 1 - step[0])
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
        weights_out[n, y, x] = weight

    return patch_weights


def _tile_kernel(channels: int, radius: int) -> Any:
    numbers = {"ROWS": _TILE[0], "COLUMNS": _TILE[1], "RADIUS": radius, "FEATURES": 3 * channels}
    return kernel("nlm.cuh", "weigh_tile", Feature=pixel_type(3 * channels), **numbers)


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
        by_patches, options = _patch_weights(channels), (steps, patch // 2, *factors, floor, is_mean)
        return lambda image, weights_out: by_patches(image, *options, weights_out)
    root, gradient = channels**0.5, 1 / (sigma_gradient * channels**0.5)
    color = [0.0, sigma_color, root] if isinstance(sigma_color, wp.array) else [1 / (sigma_color * root), None, root]
    if place.is_cpu:
        on_cpu = kernel("nlm.h", "weigh_neighbors", FEATURES=3 * channels)
        planes = wp.empty((3 * channels, height, width), dtype=float, device=place)
        room = room_for(place, width + 2 * (patch // 2) + (1 + patch) * width)

        def weigh_planes(image: Any, weights_out: Any) -> None:
            _features(channels, True)(image, *color, gradient, planes)
            inputs = [planes, steps, patch // 2, floor, is_mean]
            launch_slices(on_cpu, len(steps), inputs, weights_out, room=room)

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
    over_windows(_FILES, "add_neighbors", [weights, values, None], window, sums_out, TERM="other", KEEP=1.0)


def nlm_laplacian(weights: Any, values: Any, *, window: int, laplacian_out: Any, diagonal: Any | None = None) -> None:
    fields, term = [weights, values, diagonal], "(here - other)"
    over_windows(_FILES, "add_neighbors", fields, window, laplacian_out, TERM=term, KEEP=0.0)


def over_windows(
    files: tuple[str, str],
    name: str,
    fields: list[Any],
    window: int,
    result_out: Any,
    *,
    numbers: Sequence[Any] = (),
    **constants: Any,
) -> None:
    """Sum over the window of each pixel, by a kernel for CPUs and one for GPUs.

    A CPU does it row by row. Blocks of a GPU have a warp for each row of the half window.
    """
    device = result_out.device
    if device.is_cpu:
        inputs = [*fields, window_on(window, device.alias), *numbers]
        launch_rows(kernel(files[0], name, **constants), inputs, result_out)
        return
    (height, width), block = result_out.shape, (window // 2 + 1) * _WARP
    dim = height * -(-width // _WARP) * block
    check_size(dim)
    work = kernel(files[1], name, RADIUS=window // 2, **constants)
    launch(work, dim, [*fields, *numbers], [result_out], device=device, block_dim=block)
