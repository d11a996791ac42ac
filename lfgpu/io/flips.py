"""Cameras that are counted otherwise: from the other end, rows for columns, or along a line that turns."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError

FLIPS = ("", "u", "v", "uv")
ORDERS = ("row-major", "column-major", "serpentine", "serpentine-columns")
"""Orders in which views that are stored one after the other fill a grid: row by row, column by column, or with every
second row (or column) backwards."""


def check_flip(flip: str) -> None:
    """Raise LightFieldError unless `flip` names axes."""
    if flip not in FLIPS:
        raise LightFieldError(f"flip must be u (columns), v (rows) or uv, not {flip!r}.")


def places_in(shape: tuple[int, int], order: str) -> NDArray[np.intp]:
    """Return the (row, column) [n, 2] of each view of a full grid, in the order in which they are stored."""
    if order not in ORDERS:
        raise LightFieldError(f"order must be one of {', '.join(ORDERS)}, not {order!r}.")
    by_columns = order.endswith("columns") or order == "column-major"
    lines, length = shape[::-1] if by_columns else shape
    line, along = np.divmod(np.arange(lines * length), length)
    if order.startswith("serpentine"):
        along = np.where(line % 2 == 1, length - 1 - along, along)
    return np.stack([along, line] if by_columns else [line, along], axis=1)


def reordered(light_field: LightField, order: str) -> LightField:
    """Return the same views, which were taken for stored row by row, at the places of another order."""
    if order == ORDERS[0]:
        return light_field
    shape = light_field.grid_shape
    if shape is None:
        raise LightFieldError("order means nothing for views that do not stand in a grid; leave it out.")
    u, v = np.round(light_field.positions).astype(int).T
    row, column = places_in(shape, order)[v * shape[1] + u].T
    return _moved(light_field, np.stack([column, row], axis=1).astype(np.float64), shape)


def transposed(light_field: LightField) -> LightField:
    """Return the same views with rows and columns of cameras swapped."""
    shape = None if light_field.grid_shape is None else (light_field.grid_shape[1], light_field.grid_shape[0])
    truth = light_field.truth
    if truth is not None:
        light_field = replace(light_field, truth=replace(truth, position=truth.position[::-1]))
    return _moved(light_field, light_field.positions[:, ::-1], shape)


def flipped(light_field: LightField, flip: str) -> LightField:
    """Mirror the positions of the cameras: "u" swaps left and right, "v" top and bottom.

    The reference is the middle view again where it was the middle one before.
    """
    check_flip(flip)
    if not flip:
        return light_field
    positions = light_field.positions.copy()
    truth = light_field.truth
    spot = None if truth is None else list(truth.position)
    for axis in (0, 1):
        if "uv"[axis] not in flip:
            continue
        if light_field.grid_shape is not None:
            total = float(light_field.grid_shape[1 - axis] - 1)
        else:
            total = float(positions[:, axis].min() + positions[:, axis].max())
        positions[:, axis] = total - positions[:, axis]
        if spot is not None:
            spot[axis] = total - spot[axis]
    if truth is not None and spot is not None:
        light_field = replace(light_field, truth=replace(truth, position=(spot[0], spot[1])))
    return _moved(light_field, positions, light_field.grid_shape)


def _moved(light_field: LightField, positions: NDArray[np.float64], shape: tuple[int, int] | None) -> LightField:
    """Return the same views at other places; the reference is the middle view again if it was the middle one."""
    reference: int | None = light_field.reference_index
    if light_field.grid_shape is not None and shape is not None:
        rows, columns = light_field.grid_shape
        if tuple(light_field.positions[light_field.reference_index]) == (columns // 2, rows // 2):
            at_middle = (positions == (shape[1] // 2, shape[0] // 2)).all(axis=1).nonzero()[0]
            reference = int(at_middle[0]) if len(at_middle) else None
    return replace(light_field, positions=positions, grid_shape=shape, reference=reference)
