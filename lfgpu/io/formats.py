"""The formats of light fields that can be read: one table, an entry each, the first that recognises a path reads it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from lfgpu.errors import LightFieldError
from lfgpu.io import hci, named_views
from lfgpu.io.folders import entries, listed
from lfgpu.lightfield import LightField
from lfgpu.vignette import without_black_corners


class Reader(Protocol):
    """Reads a path that exists, or raises LightFieldError with a sentence that names the file at fault."""

    def __call__(self, path: Path, *, allow_missing: bool) -> LightField: ...


@dataclass(frozen=True)
class Format:
    """One entry of the table."""

    name: str
    """What users write to choose it: lower case, hyphens."""
    description: str
    """One line for lists and help, without a full stop."""
    recognise: Callable[[Path], str | None]
    """Why a path that exists is of this format ("it is a folder with ..."), or None. Looks at names and magic only."""
    read: Reader


FORMATS: tuple[Format, ...] = (
    # Those that are named more distinctly come first: the first one that recognises a path is taken.
    Format(
        name="hci",
        description="HCI 4D Light Field Benchmark: a folder with input_Cam000.png ... and parameters.cfg",
        recognise=hci.recognise,
        read=hci.read_hci,
    ),
    Format(
        name="named-views",
        description="a folder of images named by row and column, such as view_00_03.png or 5_5.bmp",
        recognise=named_views.recognise,
        read=named_views.read_named_views,
    ),
)


def read(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that users look for
    allow_missing: bool = False,
) -> LightField:
    """Read a light field from files.

    Parameters
    ----------
    path
        What to read, as a rule a folder of views.
    format
        Name of an entry of `FORMATS`; None finds it out from the path.
    allow_missing
        A grid of which more than half of the views are there, but not all, has probably lost some: that is an error
        unless this is True. Patterns that are meant (a cross, a star, a row, a column) and sparse grids always pass.

    Returns
    -------
    The light field. Views are uint8, uint16 or float32 as in the files; `notes` says what was noticed about them. Where
    all four corners of all views are black, as a lens array leaves them, `valid` leaves these out.

    Raises
    ------
    LightFieldError
        If the path is missing or not a known format, or if its files are damaged or contradict each other.
    """
    path = Path(path)
    chosen = recognise(path)[0] if format is None else _named(format)
    _check_exists(path)
    return without_black_corners(chosen.read(path, allow_missing=allow_missing))


def recognise(path: str | os.PathLike[str]) -> tuple[Format, str]:
    """The format of a path and why it is taken for that; LightFieldError if it is none that is known."""
    path = Path(path)
    _check_exists(path)
    for candidate in FORMATS:
        reason = candidate.recognise(path)
        if reason is not None:
            return candidate, reason
    known = "; ".join(f"{entry.name} ({entry.description})" for entry in FORMATS)
    raise LightFieldError(f"{path} is not a light field of a known format: it is {_what(path)}. Known are: {known}.")


def _named(name: str) -> Format:
    for candidate in FORMATS:
        if candidate.name == name:
            return candidate
    raise LightFieldError(f"unknown format {name!r}; known are {', '.join(entry.name for entry in FORMATS)}.")


def _check_exists(path: Path) -> None:
    try:
        path.stat()
    except FileNotFoundError:
        raise LightFieldError(f"{path} does not exist; give a folder of views or a light field file.") from None
    except OSError as error:
        raise LightFieldError(f"{path} cannot be opened: {error.strerror}.") from error


def _what(path: Path) -> str:
    if not path.is_dir():
        return "a file (give the folder that holds the views)"
    contents = entries(path)
    return f"a folder with {listed(contents)}" if contents else "an empty folder"
