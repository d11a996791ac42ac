"""Checks of arguments: numbers, texts and paths, values on a scale, and cameras at places of their own."""

import math
import os
from collections.abc import Iterable
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import interop
from lfgpu.data.mapping import each_view
from lfgpu.errors import LightFieldError

POSITION_TOLERANCE = 1e-6
"""View steps: positions that differ by less are equal."""

NEAREST = 1e-3
"""View steps: views must stand farther apart, as what is nearer to the reference tells nothing of depth."""

_FLOAT_RANGE = -0.5, 1.5  # of values on [0, 1]: resampling may overshoot a little; other units differ by much more


def array_of_numbers(name: str, values: Any, dtype: Any = None) -> NDArray[Any]:
    """Return an array of any library on the host; raise LightFieldError, with its name, if it holds no numbers."""
    if hasattr(values, "__dlpack__") or hasattr(values, "__cuda_array_interface__"):
        values = interop.on_host(name, values)
    try:
        found = np.asarray(values if dtype is None else without_masked(values))
        if dtype is not None and found.dtype.kind == "c":
            raise TypeError("complex numbers have no order")
        return found if dtype is None else found.astype(dtype, copy=False)
    except (OverflowError, TypeError, ValueError) as error:
        raise LightFieldError(f"{name} must be an array of numbers: {error}.") from error


def without_masked(values: Any) -> Any:
    """Return values with NaN for the numbers that a NumPy masked array masks: they are unknown."""
    return np.ma.filled(values.astype(np.float64), np.nan) if isinstance(values, np.ma.MaskedArray) else values


def check_number(name: str, value: Any, least: float = -math.inf, most: float = math.inf) -> None:
    """Raise LightFieldError unless `value` is a number from `least` to `most`; NaN is none."""
    if not (_is_real(value) and least <= value <= most):
        bounds = "" if math.isinf(least) and math.isinf(most) else f" from {least:g} to {most:g}"
        bounds = f" of at least {least:g}" if math.isinf(most) and not math.isinf(least) else bounds
        raise LightFieldError(f"{name} must be a number{bounds}, not {value!r:.60}.")


def _is_real(value: Any) -> bool:
    """Tell whether a value is a number that fits into a float."""
    if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def check_positive(name: str, value: Any, unit: str) -> None:
    """Raise LightFieldError unless `value` is a finite number above 0, of a `unit` that the message names."""
    if not (_is_real(value) and 0 < value < math.inf):
        raise LightFieldError(f"{name} must be a number of {unit} > 0, not {value!r:.60}.")


def check_whole(name: str, value: Any, least: int, most: float = math.inf) -> None:
    """Raise LightFieldError unless `value` is a whole number from `least` to `most`."""
    if not isinstance(value, Integral) or isinstance(value, bool) or not least <= int(value) <= most:
        bounds = f"of at least {least}" if math.isinf(most) else f"from {least} to {most:g}"
        raise LightFieldError(f"{name} must be a whole number {bounds}, not {value!r:.60}.")


def checked_sides(name: str, values: Any, meaning: str, *, least: int, most: int) -> tuple[int, ...]:
    """Return from `least` to `most` whole numbers from 1 on; raise LightFieldError with their `meaning` for others."""
    sides = tuple(values) if isinstance(values, tuple | list) else ()
    if not least <= len(sides) <= most or not all(isinstance(side, Integral) and int(side) > 0 for side in sides):
        raise LightFieldError(f"{name} must be {meaning}, whole numbers from 1 on, not {values!r:.60}.")
    return tuple(map(int, sides))


def texts(name: str, values: Any) -> tuple[str, ...]:
    """Return a sequence of texts as a tuple; raise LightFieldError if it is none, or a single text."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise LightFieldError(f"{name} must be a sequence of texts, not {values!r:.60}.")
    return tuple(map(str, values))


def named(path: str | os.PathLike[str]) -> Path:
    """Return a path; LightFieldError if it is none, no file can have that name, or it is empty (the current folder)."""
    if not isinstance(path, str | os.PathLike):
        raise LightFieldError(f"path must name a file or a folder, not {path!r:.60}.")
    if not os.fspath(path):
        raise LightFieldError("the path is empty; name a file or a folder.")
    if "\0" in os.fspath(path):
        raise LightFieldError(f"path must be without zero bytes, as all file names are, not {os.fspath(path)!r:.60}.")
    try:
        os.fsencode(path)
    except UnicodeEncodeError as error:  # half of a surrogate pair
        raise LightFieldError(f"path must be a name that files can have, not {os.fspath(path)!r:.60}.") from error
    return Path(path)


def without_mask(views: Any, valid: Any) -> tuple[Any, Any]:
    """Return the values of views that may be a NumPy masked array, and `valid` with what is not masked in any channel.

    `views` are [n, y, x] or [n, y, x, c], and `valid` is bool [n, y, x] or None.
    """
    if not isinstance(views, np.ma.MaskedArray):
        return views, valid
    mask = np.ma.getmaskarray(views)
    seen = ~mask if views.ndim == 3 else ~mask.any(axis=-1)
    return np.where(mask, views.dtype.type(0), views.data), seen if valid is None else seen & valid


def check_values(views: NDArray[Any], positions: NDArray[np.float64]) -> None:
    """Raise LightFieldError that names the view if float views [n, y, x, c] are not finite and on [0, 1]."""
    if views.dtype != np.float32:
        return
    lows, highs = np.empty((2, len(views)))

    def check(index: int, view: NDArray[Any]) -> None:
        low, high = float(view.min()), float(view.max())
        lows[index], highs[index] = low, high
        where = f"view {index} (row {positions[index, 1]:g}, column {positions[index, 0]:g})"
        if not np.isfinite(low + high):
            raise LightFieldError(f"{where} has NaN or infinite values; float views must be finite.")
        check_scaled(where, low, high)

    each_view(views, range(len(views)), check)
    low, high = lows.min(), highs.max()
    if low < _FLOAT_RANGE[0] * high:  # resampling overshoots by a part of what is there
        raise LightFieldError(f"views have values from {low:g} to {high:g}, on both sides of 0; scale them to [0, 1].")


def check_scaled(where: str, low: float, high: float) -> None:
    """Raise LightFieldError that names `where` if float values from `low` to `high` are not on [0, 1]."""
    if low < _FLOAT_RANGE[0] or high > _FLOAT_RANGE[1]:
        raise LightFieldError(f"{where} has values from {low:g} to {high:g}; scale float views to [0, 1].")


def check_distinct(positions: NDArray[np.float64]) -> None:
    """Raise LightFieldError if two of the positions [n, 2] are the same, or nearly so."""
    rounded = np.round(positions / POSITION_TOLERANCE).astype(np.int64)
    unique, counts = np.unique(rounded, axis=0, return_counts=True)
    if len(unique) < len(positions):
        u, v = unique[counts > 1][0] * POSITION_TOLERANCE
        raise LightFieldError(f"two views have the position row {v:g}, column {u:g}; all positions must differ.")
    distance, at = _nearest(positions)
    if distance <= NEAREST:
        raise LightFieldError(
            f"two views stand {distance:g} view steps apart, near row {positions[at, 1]:g}, column "
            f"{positions[at, 0]:g}; positions are in units of the distance of neighbours."
        )


def _nearest(positions: NDArray[np.float64]) -> tuple[float, int]:
    """Find the smallest distance of two positions, and the index of one of them; any larger distance unless it is below
    `NEAREST`."""
    order = np.lexsort(positions.T[::-1])
    ordered, found = positions[order], (np.inf, 0)
    for k in range(1, len(ordered)):  # each with the one k places on, until all of these are too far away in u alone
        apart = ordered[k:] - ordered[:-k]
        if apart[:, 0].min() > NEAREST:
            break
        distance = np.hypot(*apart.T)
        found = min(found, (float(distance.min()), int(order[distance.argmin()])))
    return found


def check_grid(positions: NDArray[np.float64], grid_shape: tuple[int, int]) -> None:
    """Raise LightFieldError if positions [n, 2] are not places of a grid of (rows, columns)."""
    checked_sides("grid_shape", grid_shape, "(rows, columns)", least=2, most=2)
    places = np.round(positions)
    last = (grid_shape[1] - 1, grid_shape[0] - 1)
    if np.abs(positions - places).max() > POSITION_TOLERANCE or (places < 0).any() or (places > last).any():
        raise LightFieldError(
            f"positions must be integers in the grid of {grid_shape[0]} x {grid_shape[1]} views, counted from 0; "
            f"found rows {span(positions[:, 1])} and columns {span(positions[:, 0])}."
        )


def span(values: NDArray[np.float64]) -> str:
    """Write the least and the largest value as a part of a sentence."""
    return f"{values.min():g} to {values.max():g}"
