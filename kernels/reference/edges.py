"""Weights that are small beside steps in brightness: what lies there shows what is nearer. NumPy, float64."""

import numpy as np

from lfgpu.contract import Float64Array as Array


def largest_step(image: Array, reach: int) -> Array:
    """Find the largest difference [y, x] of adjacent pixels of [y, x, c] near a pixel, a mean of channels."""
    steps = []
    for axis, window in ((1, (2 * reach + 1, 2 * reach)), (0, (2 * reach, 2 * reach + 1))):
        padded = np.pad(np.abs(np.diff(image, axis=axis)).mean(2), reach)
        steps.append(np.lib.stride_tricks.sliding_window_view(padded, window).max(axis=(2, 3)))
    return np.asarray(np.maximum(*steps))


def edge_weights(image: Array, *, contrast: float, reach: int, weights_out: Array) -> None:
    weights_out[:] = 1 / (1 + (largest_step(image, reach) / contrast) ** 2)
