"""Arrays of views that come as a whole: which axis is which, and what is kept, converted or refused."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.images import ALPHA_DROPPED, FLOAT64_ROUNDED

ASK_FOR_GRID = "say how they stand: grid=(rows, columns), --grid ROWSxCOLUMNS on the command line"


def grid_shape(path: Path, count: int, grid: tuple[int, int] | None) -> tuple[int, int]:
    """(rows, columns) of `count` views that are stored row by row: as told, else a square, else LightFieldError."""
    if grid is not None:
        rows, columns = grid
        if rows < 1 or columns < 1 or rows * columns != count:
            raise LightFieldError(f"{path} has {count} views, which is not a grid of {rows} x {columns}.")
        return rows, columns
    side = math.isqrt(count)
    if side * side != count or count < 4:
        raise LightFieldError(f"{path} has {count} views in one row of files or pages; {ASK_FOR_GRID}.")
    return side, side


def positions(shape: tuple[int, int]) -> NDArray[np.float64]:
    """[n, 2] (u, v) of the places of a full grid, row by row."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)


def arranged(path: Path, array: NDArray[Any], grid: tuple[int, int] | None) -> tuple[NDArray[Any], list[str]]:
    """An array of views as [v, u, y, x, c], and what was guessed.

    Taken are [v, u, y, x, c], [v, u, y, x], [n, y, x, c] and [n, y, x], c = 1 to 4; n views row by row, in the grid
    that is told or in a square one. A last axis of up to 4 is that of the colours.
    """
    colours = array.ndim >= 4 and array.shape[-1] <= 4
    if array.ndim not in (3, 4, 5) or 0 in array.shape or (array.ndim == 5 and not colours):
        raise LightFieldError(
            f"{path} holds an array of shape {array.shape}; views must be [v, u, y, x, c], [v, u, y, x], [n, y, x, c] "
            "or [n, y, x]."
        )
    if not colours:
        array = array[..., None]
    if array.ndim == 5:
        if grid is not None and grid != array.shape[:2]:
            raise LightFieldError(f"{path} has a grid of {array.shape[0]} x {array.shape[1]} views, not of {grid}.")
        return array, []
    shape = grid_shape(path, len(array), grid)
    notes = [] if grid else [f"The {len(array)} views are taken for a square grid, row by row."]
    return array.reshape(*shape, *array.shape[1:]), notes


def storable(path: Path, array: NDArray[Any]) -> tuple[NDArray[Any], list[str]]:
    """Views [..., c] in native byte order, without alpha, uint8, uint16 or float32; and what was converted."""
    notes = []
    if array.dtype.kind not in "fu" or array.dtype.itemsize > 8:
        raise LightFieldError(f"{path} has {array.dtype} values; views must be uint8, uint16 or float32: convert them.")
    if array.shape[-1] in (2, 4):
        array = array[..., :-1]
        notes.append(f"{ALPHA_DROPPED.capitalize()}.")
    if array.dtype.itemsize == 8 and array.dtype.kind == "f":
        with np.errstate(over="ignore"):  # what becomes infinite is refused below
            array = array.astype(np.float32)
        notes.append(f"{FLOAT64_ROUNDED.capitalize()}.")
    array = array.astype(array.dtype.newbyteorder("="), copy=False)
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        raise LightFieldError(f"{path} has {array.dtype} values; views must be uint8, uint16 or float32: convert them.")
    return array, notes


def grid_field(
    path: Path, grid: NDArray[Any], *, valid: NDArray[np.bool_] | None = None, notes: Iterable[str] = (), **fields: Any
) -> LightField:
    """A light field of a full grid [v, u, y, x, c]; `valid` is [v, u, y, x].

    Views of which nothing is valid are left out, with a note.
    """
    if grid.ndim != 5 or 0 in grid.shape:
        raise LightFieldError(f"{path} holds an array of shape {grid.shape}; views must be [v, u, y, x, c].")
    views, converted = storable(path, grid)
    shape = (int(views.shape[0]), int(views.shape[1]))
    views = np.ascontiguousarray(views).reshape(-1, *views.shape[2:])
    return field_of(
        path,
        views,
        positions(shape),
        valid=None if valid is None else valid.reshape(views.shape[:3]),
        reference=(shape[0] // 2) * shape[1] + shape[1] // 2,
        grid_shape=shape,
        notes=(*notes, *converted),
        **fields,
    )


def field_of(
    path: Path, views: NDArray[Any], where: NDArray[Any], *, valid: NDArray[np.bool_] | None = None, **fields: Any
) -> LightField:
    """A light field of views [n, y, x, c] at positions `where`, its errors with the name of the file."""
    fields.setdefault("name", path.resolve().stem)
    try:
        light_field = LightField(views, where, valid=valid, **fields)
        return light_field if valid is None else without_dark_views(light_field)
    except LightFieldError as error:
        raise LightFieldError(f"{path}: {error}") from error


def without_dark_views(light_field: LightField) -> LightField:
    """Without the views of which nothing is valid, with notes on what is not; `valid` None where everything is."""
    valid = light_field.valid
    assert valid is not None
    if valid.all():
        return replace(light_field, valid=None)
    seen: NDArray[np.bool_] = np.asarray(valid.any(axis=(1, 2)))
    if not seen[light_field.reference_index]:
        raise LightFieldError("nothing of the middle view is valid; the views may be stored in another order.")
    notes = list(light_field.notes)
    if not seen.all():
        notes.append(f"Left out {int((~seen).sum())} of {len(seen)} views, which recorded nothing of use.")
        light_field = light_field.subset([int(index) for index in np.flatnonzero(seen)])
        valid = light_field.valid
        assert valid is not None
    notes.append(f"{100 * (1 - valid.mean()):.1f} % of the pixels are marked as not valid.")
    return replace(light_field, notes=tuple(notes))
