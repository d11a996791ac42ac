"""Non-local-means weights and the two linear operators that they make: NumPy, float64.

w(p, q) = exp(-D), but at least a floor, where D is the mean or the sum over the patch of ΔI² / σ_color² +
|Δ∇I|² / σ_gradient². Δ is the difference between the patch around p and the one around q, squares are means over the
channels, and only patch pixels that both have count. ∇I is the central difference, or with `gradients` "patch", as in
the paper (equation 2), the difference between the middle of the patch and the pixel.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import NlmWeights, OverPatch, PatchGradients, half_window

Array = NDArray[np.float64]


def features(image: Array, sigma_color: float, sigma_gradient: float) -> Array:
    """[y, x, 3c]: colour and its central differences in x and y, scaled so that distances add up to the exponent."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    gradient_x = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2
    gradient_y = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    root = np.sqrt(image.shape[2])
    return np.concatenate([image / sigma_color, gradient_x / sigma_gradient, gradient_y / sigma_gradient], 2) / root


def overlap(shape: tuple[int, int], dy: int, dx: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of the pixels p for which p + (dy, dx) lies in the image, and of those p + (dy, dx)."""

    def span(size: int, step: int) -> tuple[slice, slice]:
        count = max(0, size - abs(step))
        first = min(size, max(0, -step))
        return slice(first, first + count), slice(first + step, first + step + count) if count else slice(0, 0)

    rows, columns = span(shape[0], dy), span(shape[1], dx)
    return (rows[0], columns[0]), (rows[1], columns[1])


def box_sum(a: Array, radius: int) -> Array:
    """Sums over the squares of side 2 radius + 1, cut at the borders."""
    padded = np.pad(a, radius)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(windows.sum(axis=(2, 3)))


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
    def by_central_gradients(image: Array, here: tuple[slice, slice], there: tuple[slice, slice]) -> Array:
        described = features(image, sigma_color, sigma_gradient)
        return box_sum(((described[here] - described[there]) ** 2).sum(2), patch // 2)

    def by_patch_gradients(image: Array, here: tuple[slice, slice], there: tuple[slice, slice]) -> Array:
        apart = image[here] - image[there]  # Δ∇ between patch pixel and middle is the difference of two of these
        total = np.zeros(apart.shape[:2])
        for step in np.ndindex(patch, patch):
            middle, beside = overlap(apart.shape[:2], *(np.array(step) - patch // 2))
            total[middle] += (apart[beside] ** 2).mean(2) / sigma_color**2
            total[middle] += ((apart[middle] - apart[beside]) ** 2).mean(2) / sigma_gradient**2
        return total

    def evaluate(image: Array, weights_out: Array) -> None:
        height, width = image.shape[:2]
        for k, (dy, dx) in enumerate(half_window(window)):
            here, there = overlap((height, width), dy, dx)
            weights_out[k] = 0
            if weights_out[k][here].size:
                distance = (by_central_gradients if gradients == "central" else by_patch_gradients)(image, here, there)
                if over_patch == "mean":
                    distance = distance / box_sum(np.ones_like(distance), patch // 2)
                weights_out[k][here] = np.maximum(np.exp(-distance), floor)

    return evaluate


def nlm_neighbors(weights: Array, values: Array, *, window: int, sums_out: Array) -> None:
    height, width = values.shape
    sums_out[:] = values  # the pixel itself, with weight exp(0)
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        sums_out[here] += w[here] * values[there]
        sums_out[there] += w[here] * values[here]


def nlm_laplacian(weights: Array, values: Array, *, window: int, laplacian_out: Array) -> None:
    height, width = values.shape
    laplacian_out[:] = 0
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        flow = w[here] * (values[here] - values[there])
        laplacian_out[here] += flow
        laplacian_out[there] -= flow


def nlm_ratio(
    weights: Array,
    guide: Array,
    numerator: Array,
    denominator: Array,
    *,
    window: int,
    support: float,
    floor: float,
    ratio_out: Array,
) -> None:
    height, width = guide.shape
    above, below = numerator.copy(), denominator + floor
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        shared = w[here] / (1 + ((guide[there] - guide[here]) / support) ** 2)
        for p, q in ((here, there), (there, here)):
            above[p] += shared * numerator[q]
            below[p] += shared * (denominator[q] + floor)
    ratio_out[:] = above / below


def nlm_plane(
    weights: Array,
    values: Array,
    certainty: Array,
    *,
    window: int,
    support: float,
    ridge: float,
    plane_out: Array,
) -> None:
    height, width = values.shape
    total, total_value = certainty.copy(), np.zeros(values.shape)
    first, moment = np.zeros((2, *values.shape)), np.zeros((2, *values.shape))  # sums of (x, y), and of these by values
    second = np.zeros((3, *values.shape))  # of x², x y and y²
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        shared = w[here] / (1 + ((values[there] - values[here]) / support) ** 2)
        for p, q, x, y in ((here, there, dx, dy), (there, here, -dx, -dy)):
            u, apart = shared * certainty[q], values[q] - values[p]
            total[p] += u
            total_value[p] += u * apart
            for sums, factor in zip((*first, *second), (x, y, x * x, x * y, y * y), strict=True):
                sums[p] += u * factor
            for sums, factor in zip(moment, (x, y), strict=True):
                sums[p] += u * apart * factor
    middle_x, middle_y, middle = first[0] / total, first[1] / total, total_value / total
    xx = second[0] / total - middle_x**2 + ridge
    xy = second[1] / total - middle_x * middle_y
    yy = second[2] / total - middle_y**2 + ridge
    along_x, along_y = moment[0] / total - middle_x * middle, moment[1] / total - middle_y * middle
    determinant = xx * yy - xy**2
    slope_x, slope_y = (along_x * yy - along_y * xy) / determinant, (along_y * xx - along_x * xy) / determinant
    plane_out[:] = values + middle - slope_x * middle_x - slope_y * middle_y


def nlm_on_surface(weights: Array, guide: Array, *, window: int, support: float, weights_out: Array) -> None:
    for w, out, (dy, dx) in zip(weights, weights_out, half_window(window), strict=True):
        here, there = overlap(guide.shape, dy, dx)
        out[:] = 0
        out[here] = w[here] / (1 + ((guide[there] - guide[here]) / support) ** 2)
