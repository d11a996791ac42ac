"""Non-local-means weights and the two linear operators that they make; `kernels/reference/nlm.py` says which."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import taichi as ti

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

from .landing import inside
from .memory import DeviceArray, empty, flat, optional
from .runtime import TASK, on_cpu, once, run, start


@ti.func
def step_of(k: int, radius: int):
    """(dx, dy) of the k-th of `half_window`."""
    side = 2 * radius + 1
    place = k + side * radius + radius + 1
    return ti.Vector([place % side - radius, place // side - radius])


@ti.func
def step_after(step: ti.template(), radius: int):
    """Return the step of `half_window` that follows one; `step_of` would divide."""
    following = ti.Vector([step[0] + 1, step[1]])
    if step[0] == radius:
        following = ti.Vector([-radius, step[1] + 1])
    return following


@once
def _feature_kernels(channels: int) -> SimpleNamespace:
    feature = ti.types.vector(3 * channels, ti.f32)

    @ti.kernel
    def features_kernel(
        image: flat(channels=channels),
        color: float,
        gradient: float,
        height: int,
        width: int,
        features_out: flat(channels=3 * channels),
    ):
        """Colour and its central differences in x and y, times `color` and `gradient`."""
        for p in range(features_out.shape[0]):
            x = p % width
            y = p // width
            across = image[y * width + ti.min(x + 1, width - 1)] - image[y * width + ti.max(x - 1, 0)]
            down = image[ti.min(y + 1, height - 1) * width + x] - image[ti.max(y - 1, 0) * width + x]
            f = feature(0.0)
            for c in ti.static(range(channels)):
                f[c] = color * image[p][c]
                f[c + channels] = 0.5 * gradient * across[c]
                f[c + 2 * channels] = 0.5 * gradient * down[c]
            features_out[p] = f

    @ti.kernel
    def distance_kernel(
        features: flat(channels=3 * channels), height: int, width: int, radius: int, distances_out: flat()
    ):
        """Squared feature distance of each pixel from its neighbour k; 0 where that lies outside."""
        size = height * width
        for i in range(distances_out.shape[0]):
            k = i // size
            p = i - k * size
            step = step_of(k, radius)
            distance = 0.0
            if inside(p % width + step[0], p // width + step[1], height, width):
                distance = (features[p] - features[p + step[1] * width + step[0]]).norm_sqr()
            distances_out[i] = distance

    return SimpleNamespace(features=features_kernel, distance=distance_kernel)


@once
def _weight_kernel(channels: int | None) -> Any:
    """Return what sums squared distances over the pixels of patches that both have.

    With `channels` it computes them from an image, whose gradients are the differences between the patch pixels and the
    middle of the patch; otherwise they are given for each neighbour.
    """
    given = channels is None

    @ti.kernel
    def weight_kernel(
        values: flat(channels=channels),
        height: int,
        width: int,
        radius: int,
        patch_radius: int,
        color: float,
        gradient: float,
        floor: float,
        is_mean: int,
        weights_out: flat(),
    ):
        """exp(-distance), the mean or the sum over the patch; at least `floor`."""
        size = height * width
        for i in range(weights_out.shape[0]):
            k = i // size
            p = i - k * size
            x = p % width
            y = p // width
            step = step_of(k, radius)
            weight = 0.0
            if inside(x + step[0], y + step[1], height, width):
                left = ti.max(x - patch_radius, 0, -step[0])
                right = ti.min(x + patch_radius, width - 1, width - 1 - step[0])
                top = ti.max(y - patch_radius, 0)
                bottom = ti.min(y + patch_radius, height - 1 - step[1])
                across = step[1] * width + step[0]
                total = 0.0
                for py in range(top, bottom + 1):
                    for px in range(left, right + 1):
                        q = py * width + px
                        if ti.static(given):
                            total += values[k * size + q]
                        else:
                            apart = values[q] - values[q + across]
                            middle = values[p] - values[p + across]
                            total += color * apart.norm_sqr() + gradient * (middle - apart).norm_sqr()
                if is_mean == 1:
                    total /= ti.cast((bottom - top + 1) * (right - left + 1), ti.f32)
                weight = ti.max(ti.exp(-total), floor)
            weights_out[i] = weight

    return weight_kernel


@once
def _operator(flow: Any, keep: float) -> SimpleNamespace:
    """Return kernels that start from `keep` and the diagonal, times the values, and add `flow(weight, here, other)` of
    neighbours."""

    @ti.func
    def begun(values: ti.template(), diagonal: ti.template(), has_diagonal: ti.template(), p: int):
        result = keep * values[p]
        if ti.static(has_diagonal):
            result += diagonal[p] * values[p]
        return result

    @ti.kernel
    def row_kernel(
        weights: flat(),
        values: flat(),
        diagonal: flat(),
        has_diagonal: ti.template(),
        height: int,
        width: int,
        radius: int,
        sums_out: flat(),
    ):
        """Compute a row on each thread of a CPU; the window is the outer loop, so that weights are read as they lie."""
        size = height * width
        for task in range(height * TASK):
            if task % TASK == 0:
                y = task // TASK
                row = y * width
                for x in range(width):
                    sums_out[row + x] = begun(values, diagonal, has_diagonal, row + x)
                for k in range(weights.shape[0] // size):
                    step = step_of(k, radius)
                    dx = step[0]
                    first = ti.max(0, -dx)
                    last = ti.min(width, width - dx)
                    if y + step[1] < height:
                        other = row + step[1] * width + dx
                        for x in range(first, last):
                            here = row + x
                            added = flow(weights[k * size + here], values[here], values[other + x])
                            sums_out[here] = sums_out[here] + added
                    if y - step[1] >= 0:
                        other = row - step[1] * width
                        for x in range(first, last):
                            here = row + x + dx
                            added = flow(weights[k * size + other + x], values[here], values[other + x])
                            sums_out[here] = sums_out[here] + added

    @ti.kernel
    def pixel_kernel(
        weights: flat(),
        values: flat(),
        diagonal: flat(),
        has_diagonal: ti.template(),
        height: int,
        width: int,
        radius: int,
        sums_out: flat(),
    ):
        """Compute a pixel on each thread of a GPU."""
        size = height * width
        for p in range(sums_out.shape[0]):
            x = p % width
            y = p // width
            total = begun(values, diagonal, has_diagonal, p)
            step = step_of(0, radius)
            for k in range(weights.shape[0] // size):
                for sign in ti.static((1, -1)):
                    if inside(x + sign * step[0], y + sign * step[1], height, width):
                        q = p + sign * (step[1] * width + step[0])
                        total += flow(weights[k * size + ti.min(p, q)], values[p], values[q])
                step = step_after(step, radius)
            sums_out[p] = total

    return SimpleNamespace(rows=row_kernel, pixels=pixel_kernel)


@ti.func
def _neighbor(weight: float, here: float, other: float):
    return weight * other


@ti.func
def _difference(weight: float, here: float, other: float):
    return weight * (here - other)


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
    start(device)
    (height, width, channels), by_patches = shape, gradients == "patch"
    factors = [1 / (sigma**2 * channels) for sigma in (sigma_color, sigma_gradient)]
    sizes = height, width, window // 2
    weigh = _weight_kernel(channels if by_patches else None)
    options = *sizes, patch // 2, *factors, floor, int(over_patch == "mean")
    if by_patches:
        return lambda image, weights_out: run(weigh, image, *options, weights_out)
    kernels, features = _feature_kernels(channels), empty((height, width), channels=3 * channels)
    distances = empty((len(half_window(window)), height, width))
    color, gradient = 1 / (sigma_color * channels**0.5), 1 / (sigma_gradient * channels**0.5)

    def evaluate(image: DeviceArray, weights_out: DeviceArray) -> None:
        run(kernels.features, image, color, gradient, height, width, features)
        run(kernels.distance, features, *sizes, distances)
        run(weigh, distances, *options, weights_out)

    return evaluate


def nlm_neighbors(weights: DeviceArray, values: DeviceArray, *, window: int, sums_out: DeviceArray) -> None:
    _apply(_operator(_neighbor, 1.0), weights, values, window, sums_out)


def nlm_laplacian(
    weights: DeviceArray,
    values: DeviceArray,
    *,
    window: int,
    laplacian_out: DeviceArray,
    diagonal: DeviceArray | None = None,
) -> None:
    _apply(_operator(_difference, 0.0), weights, values, window, laplacian_out, diagonal)


def _apply(
    operator: SimpleNamespace,
    weights: DeviceArray,
    values: DeviceArray,
    window: int,
    result_out: DeviceArray,
    diagonal: DeviceArray | None = None,
) -> None:
    kernel = operator.rows if on_cpu() else operator.pixels
    inputs = weights, values, *optional(diagonal)
    run(kernel, *inputs, *values.shape, window // 2, result_out)
