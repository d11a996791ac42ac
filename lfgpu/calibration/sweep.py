"""A small plane sweep at some points of the reference view: at which disparity other views show the same there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array

LABELS = 65
"""Disparities that are tried."""

_REACH = 2  # pixels to each side of a point that its patch goes


def sweep(
    patch: NDArray[np.float32],
    pictures: list[NDArray[np.float32]],
    offsets: Float64Array,
    x: NDArray[np.intp],
    y: NDArray[np.intp],
    labels: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """The least cost [p] of each point, and the disparity that has it.

    The cost is the mean absolute difference of patches without their mean and contrast, in the better three quarters of
    the pictures. `patch` [p, 25] is what the reference shows, `offsets` are those of the pictures.
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


def patches(
    picture: NDArray[np.float32], x: NDArray[np.intp], y: NDArray[np.intp], right: float = 0.0, down: float = 0.0
) -> NDArray[np.float32]:
    """The 5 x 5 pixels [p, 25] of a picture around points that are moved by so much, bilinear; its border goes on."""
    height, width = picture.shape
    column, row = math.floor(right), math.floor(down)
    across, along = np.float32(right - column), np.float32(down - row)
    reach = np.arange(-_REACH, _REACH + 2)
    rows = (y[:, None] + (row + reach)).clip(0, height - 1)
    columns = (x[:, None] + (column + reach)).clip(0, width - 1)
    found = picture[rows[:, :, None], columns[:, None, :]]
    found = (1 - along) * found[:, :-1] + along * found[:, 1:]
    found = (1 - across) * found[:, :, :-1] + across * found[:, :, 1:]
    return found.reshape(len(x), -1)


def _plain(patch: NDArray[np.floating]) -> Float64Array:
    """Patches [p, k] without their mean and contrast."""
    centred = patch - patch.mean(1, keepdims=True)
    return np.asarray(centred / (np.abs(centred).mean(1, keepdims=True) + np.float32(3e-3)))
