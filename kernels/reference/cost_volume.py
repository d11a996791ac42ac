"""Cost volumes [l, y, x], one slice for each disparity: averages of like pixels, and the least. NumPy, float64.

Only what is alike is averaged: the weights are those of the non-local-means prior, with 1 for the pixel itself.
"""

import numpy as np

from lfgpu.contract import REDUCTION, Float64Array as Array

from .nlm import nlm_neighbors

LEAST_BEND = 1e-9  # of a parabola that has a minimum


def nlm_average(weights: Array, volume: Array, *, window: int, average_out: Array) -> None:
    total = np.empty(volume.shape[1:])
    nlm_neighbors(weights, np.ones(total.shape), window=window, sums_out=total)
    for costs, average in zip(volume, average_out, strict=True):
        nlm_neighbors(weights, costs, window=window, sums_out=average)
        average /= total


def add_reduced(reduced: Array, shares: Array, *, weight: float, volume_inout: Array) -> None:
    places = [
        np.clip((np.arange(size) + 0.5) / REDUCTION - 0.5, 0, small - 1)
        for size, small in zip(volume_inout.shape[1:], reduced.shape[1:], strict=True)
    ]
    volume_inout += weight * _between(_between(shares * reduced, places[0], 1), places[1], 2)


def _between(values: Array, places: Array, axis: int) -> Array:
    """Values at places along an axis, linear between the nearest."""
    before = np.floor(places).astype(int)
    after = np.minimum(before + 1, values.shape[axis] - 1)
    share = (places - before).reshape([-1 if a == axis else 1 for a in range(values.ndim)])
    return np.asarray((1 - share) * values.take(before, axis) + share * values.take(after, axis))


def least_costs(volume: Array, *, least_out: Array) -> None:
    least_out[:] = volume.min(0)


def winner_takes_all(volume: Array, *, first: float, step: float, disparity_out: Array) -> None:
    k = volume.argmin(0).clip(1, len(volume) - 2)
    before, here, after = (np.take_along_axis(volume, (k + near)[None], 0)[0] for near in (-1, 0, 1))
    disparity_out[:] = first + step * (k + parabola_vertex(before, here, after))


def parabola_vertex(before: Array, here: Array, after: Array) -> Array:
    """Find the least place, -1 to 1, of the parabola through values at -1, 0 and 1; 0 where it has none."""
    bend = before - 2 * here + after
    bends = bend > LEAST_BEND
    return np.where(bends, (before - after) / (2 * np.where(bends, bend, 1.0)), 0.0).clip(-1, 1)
