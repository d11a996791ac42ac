"""Trends that most views follow, and the views that stand out from them."""

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array

_ROUNDS = 30
_SOFT = 1e-4  # keeps weights of the least absolute deviations finite
_DEPENDENT = 1e-12  # of the largest singular value: less is no direction
_TREND = 6  # parameters of the trend
_ALIKE = 8  # views that are compared with each other, those about as far from the reference
_FACTOR = 6.0  # times the usual distance: what lies further stands out

UNLIKE = 0.1
"""Pixels by which edges of a view seem to stand off, beyond those of the others, if it does not show what they do."""
MANY = 25
"""Views from which a smooth trend over the array is taken out before outliers are looked for."""


def median(values: Float64Array) -> float:
    """Find the median of values [n], none of them NaN: to look for NaN, as NumPy does, takes three times as long."""
    below, above = (len(values) - 1) // 2, len(values) // 2
    parts = np.partition(values, below)
    return float(parts[below] if above == below else (parts[below] + parts[above:].min()) / 2)


def without_gauge(shifts: Float64Array, offsets: Float64Array) -> Float64Array:
    """Remove from shifts [n, 2] the part that views cannot tell: all moved alike, or in proportion to their offsets.

    The fit is of least absolute deviations: views that stand out do not spoil it. `shifts` may be [n, 2, t]; then the
    fit to each of the t columns is of least squares.
    """
    count = len(offsets)
    axes = np.zeros((count, 2, 3))
    axes[:, 0, 0] = axes[:, 1, 1] = 1
    axes[:, :, 2] = offsets
    basis = axes.reshape(2 * count, 3)
    flat = shifts.reshape(2 * count, -1)
    if shifts.ndim == 3:
        return np.asarray((flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]).reshape(shifts.shape))
    return np.asarray(robust_rest(basis, flat).reshape(shifts.shape))


def without_slope(values: Float64Array, offsets: Float64Array) -> Float64Array:
    """Remove from values [n] (or [n, t]) their mean and the part that grows in proportion to the offsets.

    The fit is that of `without_gauge`. Rotations and scales of that form are hardly told from a map that is tilted as
    a whole.
    """
    basis = np.concatenate([np.ones((len(offsets), 1)), offsets], axis=1)
    if values.ndim == 2:
        return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])
    return robust_rest(basis, values[:, None])[:, 0]


def outliers(values: Float64Array, offsets: Float64Array, errors: Float64Array, *, least: float) -> NDArray[np.bool_]:
    """Find the values [n, k] of views that stand out from a smooth trend over the array.

    The distance of such a value from the trend exceeds three limits: `least`; `_FACTOR` times the usual distance (1.48
    times the median), also that of the views about as far from the reference; and `_FACTOR` times its standard error.
    Views from the rim of a lens depart from any trend more than others do.
    """
    rest = smooth_rest(values, offsets)
    usual = np.full(len(rest), 1.4826 * np.median(np.abs(rest)))
    if len(values) >= MANY:
        distance = np.hypot(*offsets.T)
        alike = np.argsort(np.abs(distance[:, None] - distance), axis=1, kind="stable")[:, :_ALIKE]
        usual = np.maximum(usual, 1.4826 * np.median(np.abs(rest)[alike], axis=(1, 2)))
    size = np.linalg.norm(rest, axis=1)
    least = np.maximum(least, _FACTOR * np.maximum(usual, np.linalg.norm(errors, axis=1)))
    return np.asarray(size > least)


def unlike(misfit: Float64Array, offsets: Float64Array) -> NDArray[np.bool_]:
    """Find the views that do not show what the others do, by their misfit [n] in pixels (`Bundle.misfit`)."""
    return outliers(misfit[:, None], offsets, np.zeros((len(misfit), 1)), least=UNLIKE) & (misfit > np.median(misfit))


def smooth_rest(values: Float64Array, offsets: Float64Array, rounds: int = _ROUNDS) -> Float64Array:
    """Remove a trend from values [n, k]: a polynomial of degree 2 in the offsets if there are many views, else the
    median. After few `rounds` it still gives way to views that stand out."""
    if len(values) < MANY:
        return values - np.median(values, axis=0)
    u, v = (offsets / max(float(np.abs(offsets).max()), 1e-9)).T
    basis = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    return robust_rest(basis, values, rounds)


def usual_rest(rest: Float64Array) -> float:
    """Usual distance of values [n, k] from the trend that `smooth_rest` removed (1.48 times the median).

    A fit of least absolute deviations passes through as many values as it has parameters; these do not count.
    """
    through = rest.shape[1] * (_TREND if len(rest) >= MANY else 1)
    return 1.4826 * median(np.sort(np.abs(rest), axis=None)[through:])


def robust_rest(basis: Float64Array, values: Float64Array, rounds: int = _ROUNDS) -> Float64Array:
    """Remove from each column of values [n, k] its fit of least absolute deviations by columns of a basis."""
    left, sizes, _ = np.linalg.svd(basis, full_matrices=False)
    columns = left[:, sizes > _DEPENDENT * sizes[0]]  # cameras in one line tell nothing of the other axis
    rest, weight = values, np.ones_like(values)
    for _ in range(rounds):
        weighted = columns.T * weight.T[:, None]
        found = np.linalg.solve(weighted @ columns, weighted @ values.T[..., None])
        rest = values - (columns @ found[..., 0].T)
        weight = 1 / np.maximum(np.abs(rest), _SOFT)
    return rest
