"""Plane sweep at points of the reference view, on the host: the disparity at which other views show the same there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras.surface import patches
from lfgpu.contract import Float64Array

LABELS = 65
"""Number of disparities that are tried."""


def sweep(
    patch: NDArray[np.float32],
    pictures: list[NDArray[np.float32]],
    offsets: Float64Array,
    x: NDArray[np.intp],
    y: NDArray[np.intp],
    labels: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """Find the least cost [p] of each point, and its disparity.

    The cost is the mean absolute difference of patches without their mean and contrast, in the better three quarters of
    the pictures. `patch` [p, 25] is cut from the reference, `offsets` are those of the pictures.
    """
    best, chosen = np.full(len(patch), np.inf), np.zeros(len(patch))
    plain = _plain(patch)
    for d in labels:
        costs = [
            np.abs(_plain(patches(picture, x, y, -d * du, -d * dv)) - plain)
            for picture, (du, dv) in zip(pictures, offsets, strict=True)
        ]
        better = np.sort(np.stack(costs).mean(2), axis=0)[: (3 * len(pictures) + 3) // 4]
        cost = better.mean(0)
        chosen = np.where(cost < best, d, chosen)
        best = np.minimum(best, cost)
    return best, chosen


def _plain(patch: NDArray[np.floating]) -> Float64Array:
    """Patches [p, k] without their mean and contrast."""
    centred = patch - patch.mean(1, keepdims=True)
    return np.asarray(centred / (np.abs(centred).mean(1, keepdims=True) + np.float32(3e-3)))
