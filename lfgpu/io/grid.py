"""Files at places of a grid as a light field: duplicates, holes and the centre are what can be wrong with it."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.reporting import within
from lfgpu.io.views import load_views

Place: TypeAlias = tuple[int, int]
"""(row, column) in a grid, from 0."""

Needed: TypeAlias = Callable[[NDArray[np.float64]], Sequence[int] | NDArray[np.intp]]
"""Chooses views by their offsets [n, 2] from the reference view: indices in order, the reference among them."""


@dataclass
class Part:
    """Choice of the views of a grid that are read, and whether it left out any."""

    needed: Needed | None
    left_out: bool = False


_PART: ContextVar[Part | None] = ContextVar("views that are read", default=None)


def in_part(needed: Needed | None) -> AbstractContextManager[Part]:
    """Have readers of grids in this block leave out the views that are not needed; None: all are needed."""
    return within(_PART, Part(needed))


def reads_in_part() -> bool:
    """Tell whether a reader is asked to leave out views that are not needed."""
    part = _PART.get()
    return part is not None and part.needed is not None


def needed_of(offsets: NDArray[np.float64]) -> Sequence[int] | NDArray[np.intp]:
    """Choose the views that are needed by their offsets [n, 2] from the reference; all, unless `in_part` says which."""
    part = _PART.get()
    if part is None or part.needed is None:
        return range(len(offsets))
    kept = part.needed(offsets)
    part.left_out = 2 <= len(kept) < len(offsets)
    return kept if part.left_out else range(len(offsets))  # of one alone whoever asked for it says what is wrong


_NAMED_HOLES = 5  # so many missing places are named in a message


def by_place(files: Iterable[tuple[Place, Path]]) -> dict[Place, Path]:
    """Files by their place; LightFieldError naming both if two files claim one place."""
    places: dict[Place, Path] = {}
    for place, file in files:
        if place in places:
            raise LightFieldError(
                f"{file.parent} has two files for the view at row {place[0]}, column {place[1]}: "
                f"{places[place].name} and {file.name}; remove one."
            )
        places[place] = file
    return places


def read_grid(
    files: Mapping[Place, Path],
    shape: tuple[int, int],
    *,
    folder: Path,
    allow_missing: bool,
    reference: Place | None = None,
    notes: Collection[str] = (),
) -> LightField:
    """Read files at places of a grid (rows, columns); the light field is named after the folder, as messages are.

    The view at the place `reference`, by default the centre, is the reference. `allow_missing` accepts holes that look
    like an accident (see `holes`). `notes` come before what is noticed here.
    """
    if len(files) < 2:
        only = next(iter(files.values())).name
        raise LightFieldError(f"{folder} has one view only ({only}); depth needs at least two views of the scene.")
    places = sorted(files)
    hole_notes = holes(places, shape, folder=folder, allow_missing=allow_missing)
    centre = reference or (shape[0] // 2, shape[1] // 2)
    kept = needed_of(np.subtract(places, centre, dtype=np.float64)[:, ::-1]) if centre in files else range(len(places))
    views, valid, image_notes = load_views([files[place] for place in places], kept)
    places = [places[index] for index in kept]
    light_field = LightField(
        views,
        np.array([(column, row) for row, column in places], np.float64),
        # Without the centre view LightField takes the nearest one.
        reference=places.index(centre) if centre in files else None,
        grid_shape=shape,
        valid=valid,
        files=tuple(str(files[place]) for place in places),
        name=folder.resolve().name,
        notes=(*notes, *hole_notes, *image_notes),
    )
    if centre in files:
        return light_field
    row, column = places[light_field.reference_index]
    missing = (
        f"The centre view (row {centre[0]}, column {centre[1]}) is missing; "
        f"the reference is the view at row {row}, column {column}."
    )
    return replace(light_field, notes=(*light_field.notes, missing))


def check_told(by: Path, light_field: LightField, shape: tuple[int, int]) -> None:
    """Raise LightFieldError unless a light field has the rows and columns that a file or the name of a folder tells."""
    if light_field.grid_shape != shape:
        raise LightFieldError(
            f"{by} says {shape[0]} x {shape[1]} views, found a grid of "
            f"{' x '.join(map(str, light_field.grid_shape or ()))}; add the missing ones, or pass allow_missing=True "
            "(--allow-missing on the command line)."
        )


def holes(places: Collection[Place], shape: tuple[int, int], *, folder: Path, allow_missing: bool) -> tuple[str, ...]:
    """Describe the empty places of a grid in notes; raise LightFieldError if they look like an accident.

    A full grid, and a cross, star, row or column through the centre (rows // 2, columns // 2), are meant and pass
    without a word. Any other choice of at most half of the places passes with a note. If more than half are there,
    but not all, files were probably lost: that is an error unless `allow_missing` is True.
    """
    rows, columns = shape
    present = set(places)
    total = rows * columns
    if len(present) == total or pattern_of(present, shape) is not None:
        return ()
    if len(present) * 2 > total and not allow_missing:
        empty = [(row, column) for row in range(rows) for column in range(columns) if (row, column) not in present]
        named = ", ".join(f"row {row} column {column}" for row, column in empty[:_NAMED_HOLES])
        more = ", ..." if len(empty) > _NAMED_HOLES else ""
        raise LightFieldError(
            f"{folder} lacks {len(empty)} of the {total} views of its {rows} x {columns} grid ({named}{more}, counted "
            "from 0); add them, or pass allow_missing=True (--allow-missing on the command line) to go without."
        )
    return (f"{len(present)} of {total} views of the {rows} x {columns} grid are there.",)


def pattern_of(places: Collection[Place], shape: tuple[int, int]) -> str | None:
    """Name the pattern that places through the centre of a grid make: "cross", "star", "row", "column", or None."""
    middle_row, middle_column = shape[0] // 2, shape[1] // 2
    row = {(middle_row, column) for column in range(shape[1])}
    column = {(row, middle_column) for row in range(shape[0])}
    reach = range(-max(shape), max(shape) + 1)
    diagonals = {(middle_row + step, middle_column + sign * step) for step in reach for sign in (-1, 1)}
    inside = {(row, column) for row, column in diagonals if 0 <= row < shape[0] and 0 <= column < shape[1]}
    known = {"row": row, "column": column, "cross": row | column, "star": row | column | inside}
    return next((name for name, its in known.items() if its == set(places)), None)
