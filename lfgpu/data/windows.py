"""Filters over square windows and over channels, by NumPy alone: SciPy's take longer to import than to run."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def window_max(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Find the largest of the size x size pixels around each pixel [y, x], within the image; size is odd."""
    return _along_both(_extremes(np.maximum), values, size, "edge")


def window_min(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Find the smallest value; as `window_max`."""
    return _along_both(_extremes(np.minimum), values, size, "edge")


def window_mean(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Average the size x size pixels around each pixel [y, x], mirrored at the borders; size is odd."""
    return _along_both(_sums, values, size, "symmetric") / values.dtype.type(size**2)


def smoothed(values: NDArray[np.float32], deviation: float) -> NDArray[np.float32]:
    """Smooth an image [y, x], mirrored at its borders, by a Gaussian of that standard deviation in pixels."""
    places = np.arange(-int(4 * deviation + 0.5), int(4 * deviation + 0.5) + 1)
    weights = np.exp(-0.5 * (places / deviation) ** 2)
    for axis in (0, 1):
        values = _weighted(values, tuple(weights / weights.sum()), axis)
    return values


def gradient_size(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the length of the gradient of an image [y, x], differences per pixel, by Sobel's filters."""
    slopes = [_weighted(_weighted(values, (-0.5, 0, 0.5), axis), (0.25, 0.5, 0.25), 1 - axis) for axis in (0, 1)]
    return np.hypot(*slopes)


def differences(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Compute the differences per pixel along an axis of an image [y, x]; 0 if it is one pixel long."""
    return np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values)


def eroded(known: NDArray[np.bool_], times: int) -> NDArray[np.bool_]:
    """Pixels [y, x] from which nothing that is not set, and no border, is `times` steps along the axes away or less."""
    for _ in range(times):
        around = np.pad(known, 1)
        known = known & around[:-2, 1:-1] & around[2:, 1:-1] & around[1:-1, :-2] & around[1:-1, 2:]
    return known


def _weighted(values: NDArray[np.float32], weights: Sequence[float], axis: int) -> NDArray[np.float32]:
    """Sums with weights along an axis, mirrored at its ends."""
    radius = len(weights) // 2
    around = np.pad(values, [(radius, radius) if axis == k else (0, 0) for k in (0, 1)], mode="symmetric")
    along = np.moveaxis(around, axis, 0)
    total = np.zeros_like(along[: values.shape[axis]])
    for k, weight in enumerate(weights):
        if weight:
            total += np.float32(weight) * along[k : k + values.shape[axis]]
    return np.moveaxis(total, 0, axis)


_Windows = Callable[[NDArray[Any], int], NDArray[Any]]
"""Joins each value along the first axis and those after it, so many in all."""


def _along_both(join: _Windows, values: NDArray[Any], size: int, beyond: Any) -> NDArray[Any]:
    radius = size // 2
    for axis in (0, 1):
        around = np.pad(values, [(radius, radius) if axis == k else (0, 0) for k in (0, 1)], mode=beyond)
        values = np.moveaxis(join(np.moveaxis(around, axis, 0), size), 0, axis)
    return values


def _sums(values: NDArray[Any], size: int) -> NDArray[Any]:
    count = len(values) - size + 1
    total = values[:count].copy()
    for k in range(1, size):
        total += values[k : k + count]
    return total


def _extremes(join: Callable[..., NDArray[Any]]) -> _Windows:
    """Join windows by halves, which may overlap."""

    def of_windows(values: NDArray[Any], size: int) -> NDArray[Any]:
        if size == 1:
            return values
        half = (size + 1) // 2
        halves = of_windows(values, half)
        return join(halves[: len(values) - size + 1], halves[size - half :])

    return of_windows


def mean_of_channels(values: NDArray[Any], dtype: type[np.floating]) -> NDArray[Any]:
    """Average along the last axis, which is so short that NumPy is slow to add it up: float [...] of `dtype`."""
    total = values[..., 0].astype(dtype)
    for c in range(1, values.shape[-1]):
        total += values[..., c]
    return np.asarray(total / dtype(values.shape[-1]))
