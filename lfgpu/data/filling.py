"""Maps without holes: what is not known is taken from the farther side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.contract import Float32Array
from lfgpu.data.light_field_checks import array_of_numbers
from lfgpu.data.result import DepthResult
from lfgpu.errors import LightFieldError


def fill_unknown(disparity: ArrayLike) -> Float32Array:
    """Replace each NaN by the farthest of the nearest known values to the left, right, above and below.

    A hole beside a depth edge belongs to the farther side, which the nearer side hides. A NaN without a known value in
    its row and column takes the value of a neighbour that was filled. The values are guesses: nothing was seen there.

    Parameters
    ----------
    disparity
        [y, x], or [n, y, x] for maps that are filled one by one; pixels per view step, larger is nearer.

    Returns
    -------
    float32, of the same shape.

    Raises
    ------
    LightFieldError
        If it is no such array, or a map has no value at all.

    Examples
    --------
    >>> lfgpu.fill_unknown([[1.0, np.nan, 3.0]]).tolist()
    [[1.0, 1.0, 3.0]]
    """
    maps = array_of_numbers("disparity", disparity, np.float32)
    if maps.ndim == 3:
        return np.stack([fill_unknown(map_) for map_ in maps])
    if maps.ndim != 2:
        raise LightFieldError(f"disparity must be [y, x] or [n, y, x], found shape {maps.shape}.")
    if np.isnan(maps).all():
        raise LightFieldError("the map cannot be filled, as it has no known value.")
    values = np.where(np.isnan(maps), np.float32(np.inf), maps)
    unknown = np.isnan(maps)
    while unknown.any():
        sides = [_next_value(np.rot90(values, turns), np.rot90(unknown, turns)) for turns in range(4)]
        farthest = np.min([np.rot90(side, -turns) for turns, side in enumerate(sides)], axis=0)
        values = np.where(unknown, farthest, values)
        unknown &= np.isposinf(values)
    return values


def filled(result: DepthResult) -> DepthResult:
    """Fill the holes of a result; its confidence is 0 there, and its status says how much was filled."""
    unknown = float(np.isnan(result.disparity).mean())
    if not unknown:
        return result
    uncertainty = result.uncertainty
    return replace(
        result,
        disparity=fill_unknown(result.disparity),
        uncertainty=None if uncertainty is None else np.where(np.isnan(uncertainty), np.float32(np.inf), uncertainty),
        status=f"{result.status} {100 * unknown:.2g} % of the pixels are not known; they were filled from the farther "
        "side, with confidence 0.",
    )


def _next_value(values: Float32Array, unknown: NDArray[np.bool_]) -> Float32Array:
    """Replace each unknown value by the next known one to the left, where there is one."""
    columns = np.where(unknown, 0, np.arange(values.shape[1]))
    return np.take_along_axis(values, np.maximum.accumulate(columns, axis=1), axis=1)
