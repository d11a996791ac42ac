"""Non-local-means weights and the two linear operators that they make: NumPy, float64.

w(p, q) = exp(-D), but at least a floor, where D is the mean or the sum over the patch of ΔI² / σ_color² +
|Δ∇I|² / σ_gradient². Δ is the difference between the patch around p and the one around q, squares are means over the
channels, and only patch pixels that both have count. ∇I is the central difference, or with `gradients` "patch", as in
the paper (equation 2), the difference between the middle of the patch and the pixel.
"""

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import Float64Array as Array, NlmWeights, OverPatch, PatchGradients, half_window


def features(image: Array, sigma_color: float, sigma_gradient: float) -> Array:
    """[y, x, 3c]: colour and its central differences in x and y, scaled so that distances add up to the exponent."""
    gradients = [gradient / sigma_gradient for gradient in central_differences(image)]
    return np.concatenate([image / sigma_color, *gradients], 2) / np.sqrt(image.shape[2])


def central_differences(values: Array) -> tuple[Array, Array]:
    """Half the differences of the pixels beside in x and in y, of [y, x, c]; borders go on."""
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2


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


def nlm_laplacian(
    weights: Array, values: Array, *, window: int, laplacian_out: Array, diagonal: Array | None = None
) -> None:
    height, width = values.shape
    laplacian_out[:] = 0 if diagonal is None else diagonal * values
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        flow = w[here] * (values[here] - values[there])
        laplacian_out[here] += flow
        laplacian_out[there] -= flow
