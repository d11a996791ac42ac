"""Cameras that are counted otherwise: from the other end, rows for columns, or along a line that turns."""

from collections.abc import Callable
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
    places = places_in(shape, order)

    def move(where: NDArray[np.float64]) -> NDArray[np.float64]:
        u, v = np.round(where).astype(int).T
        return places[v * shape[1] + u][..., ::-1].astype(np.float64)

    return _moved(light_field, move, shape)


def transposed(light_field: LightField) -> LightField:
    """Return the same views with rows and columns of cameras swapped."""
    shape = None if light_field.grid_shape is None else (light_field.grid_shape[1], light_field.grid_shape[0])
    return _moved(light_field, lambda where: where[..., ::-1], shape)


def flipped(light_field: LightField, flip: str) -> LightField:
    """Mirror the positions of the cameras: "u" swaps left and right, "v" top and bottom.

    The reference is the middle view again where it was the middle one before.
    """
    check_flip(flip)
    shape, positions = light_field.grid_shape, light_field.positions
    total = positions.min(0) + positions.max(0) if shape is None else np.subtract(shape[::-1], 1)
    mirrored = [axis in flip for axis in "uv"]
    return _moved(light_field, lambda where: np.where(mirrored, total - where, where), shape) if flip else light_field


def _moved(
    light_field: LightField, move: Callable[[NDArray[np.float64]], NDArray[np.float64]], shape: tuple[int, int] | None
) -> LightField:
    """Return the same views, and their truth, where `move` puts places [..., 2].

    The reference is the middle view again if it was the middle one.
    """
    positions, truth = move(light_field.positions), light_field.truth
    reference: int | None = light_field.reference_index
    if light_field.grid_shape is not None and shape is not None:
        rows, columns = light_field.grid_shape
        if tuple(light_field.positions[light_field.reference_index]) == (columns // 2, rows // 2):
            at_middle = (positions == (shape[1] // 2, shape[0] // 2)).all(axis=1).nonzero()[0]
            reference = int(at_middle[0]) if len(at_middle) else None
    if truth is not None:
        u, v = move(np.array(truth.position)).tolist()
        truth = replace(truth, position=(u, v))
    return replace(light_field, positions=positions, grid_shape=shape, reference=reference, truth=truth)
