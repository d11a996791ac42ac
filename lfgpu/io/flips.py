"""Cameras that are counted the other way round."""

from __future__ import annotations

from dataclasses import replace

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError

FLIPS = ("", "u", "v", "uv")


def check_flip(flip: str) -> None:
    """LightFieldError unless `flip` names axes."""
    if flip not in FLIPS:
        raise LightFieldError(f"flip must be u (columns), v (rows) or uv, not {flip!r}.")


def flipped(light_field: LightField, flip: str) -> LightField:
    """The same views with the positions of their cameras mirrored: "u" swaps left and right, "v" top and bottom.

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
    reference: int | None = light_field.reference_index
    if light_field.grid_shape is not None:
        rows, columns = light_field.grid_shape
        middle = (columns // 2, rows // 2)
        if tuple(light_field.positions[light_field.reference_index]) == middle:
            at_middle = (positions == middle).all(axis=1).nonzero()[0]
            reference = int(at_middle[0]) if len(at_middle) else None
    if truth is not None and spot is not None:
        truth = replace(truth, position=(spot[0], spot[1]))
    return replace(light_field, positions=positions, reference=reference, truth=truth)
