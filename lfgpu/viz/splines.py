"""Images between their pixels: cubic splines, which keep them sharper than bilinear interpolation does."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfgpu.contract import Float32Array

LINEAR, CUBIC = 1, 3
"""Orders of the polynomials between pixels."""

_PAD = 2  # pixels beyond the frame that a cubic spline at its border looks at


def spline(image: Float32Array) -> Float32Array:
    """Compute cubic spline coefficients [c, y, x] of an image [y, x, c], which is mirrored at its border."""
    planes = np.moveaxis(image, 2, 0)
    return np.stack([ndimage.spline_filter(plane, CUBIC, output=np.float32, mode="mirror") for plane in planes])


def colours(coefficients: Float32Array, at: Float32Array, order: int = CUBIC) -> Float32Array:
    """Sample colours [y, x, c] at rows and columns [2, y, x], mirrored beyond the frame.

    `coefficients` [c, y, x] are those of `spline`, or for order 1 the pixels themselves.
    """
    found = np.empty((*at.shape[1:], len(coefficients)), np.float32)
    for channel, plane in enumerate(coefficients):
        found[..., channel] = sampled(plane, at, order)
    return found


def sampled(values: Float32Array, at: Float32Array, order: int) -> Float32Array:
    """Sample values [y, x] at rows and columns [2, y, x]: nearest (order 0), bilinear (1), or from coefficients (3)."""
    found: Float32Array = ndimage.map_coordinates(
        values, at, output=np.float32, order=order, mode="mirror", prefilter=False
    )
    return found


def valid_at(valid: np.ndarray, at: Float32Array) -> np.ndarray:
    """Tell, bool [y, x], whether all pixels of a mask around rows and columns [2, y, x] are True."""
    return np.asarray(sampled(valid.astype(np.float32), at, LINEAR) > 1 - 1e-3)


def shifted(values: NDArray[Any], move: tuple[float, ...], order: int) -> tuple[tuple[slice, slice], Float32Array]:
    """Sample the place `move` beside every pixel: as `colours`, but faster, as all pixels have one move.

    `values` [y, x, c] are the coefficients of `spline`, or for order 1 the pixels themselves. Returns which of these
    pixels have their place inside the frame, as slices of rows and columns, and float32 [y, x, c] there.
    """
    rows, columns = (_taps(m, side, order) for m, side in zip(move, values.shape[:2], strict=True))
    padded = np.pad(values, ((_PAD, _PAD), (_PAD, _PAD), (0, 0)), mode="reflect")
    down = _weighted((padded[place], weight) for place, weight in rows[1])
    return (rows[0], columns[0]), _weighted((down[:, place], weight) for place, weight in columns[1])


def _weighted(terms: Iterable[tuple[NDArray[Any], np.float32]]) -> Float32Array:
    (values, weight), *others = terms
    total: Float32Array = values * weight
    for values, weight in others:
        if weight:
            total += values * weight
    return total


def _taps(move: float, length: int, order: int) -> tuple[slice, list[tuple[slice, np.float32]]]:
    """Return which pixels of an axis have their place inside, and the weights of the padded axis."""
    whole = math.floor(move)
    t = move - whole
    s = 1 - t
    if order == LINEAR:
        weights = {0: s, 1: t}
    else:  # the cubic B-spline at distances 1 + t, t, s, 1 + s
        near = {0: (4 - 6 * t**2 + 3 * t**3) / 6, 1: (4 - 6 * s**2 + 3 * s**3) / 6}
        weights = {-1: s**3 / 6, **near, 2: t**3 / 6}
    first = max(0, math.ceil(-move))
    count = max(0, min(math.floor(length - 1 - move) + 1, length) - first)
    start = first + whole + _PAD
    taps = [
        (slice(start + tap, start + tap + count) if count else slice(0, 0), np.float32(weight))
        for tap, weight in weights.items()
    ]
    return slice(first, first + count), taps
