"""Folders of images whose names end in row and column: view_00_03.png, 2067_05_05.png, 5_5.bmp, r2c5.png."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import image_files, listed, sub_folders
from lfgpu.io.grid import by_place, read_grid

# The last two numbers of a name. Row and column have at most three digits, so that dates and times are none.
_NAME = re.compile(r"(.*?)(?<![0-9])([0-9]{1,3})([^0-9]+)([0-9]{1,3})([^0-9]*)", re.DOTALL)


@dataclass(frozen=True)
class _NamedView:
    file: Path
    row: int
    column: int
    text: tuple[str, str, str]
    """What stands before, between and after row and column: the same for all views of one scene."""


def recognise(path: Path) -> str | None:
    """Why a path is taken for a folder of named views; None if it is not."""
    if not path.is_dir():
        return None
    if views := _named_views(path):
        return f"it is a folder with images named by row and column, such as {views[0].file.name}"
    folders = [folder for folder in sub_folders(path) if _named_views(folder)]
    return f"its folder {folders[0].name} has images named by row and column" if folders else None


def read_named_views(path: Path, *, allow_missing: bool = False) -> LightField:
    """Read a folder of images whose names end in two numbers, the row (v, downwards) and the column (u, rightwards).

    Whatever else is in the names must be the same in all of them. Numbers may start at 0 or at 1, which the lowest
    one tells. Images named otherwise are left out, with a note. If the folder itself has no such images but exactly
    one of its direct sub-folders has, that one is read.

    Parameters
    ----------
    path
        The folder.
    allow_missing
        Whether a grid that seems to have lost some views is accepted.

    Raises
    ------
    LightFieldError
        If there are no such images, or they are damaged or contradict each other; the sentence names files.
    """
    folder, notes = _folder_with_views(path)
    views = _named_views(folder)
    _check_one_scene(views)
    named = {view.file for view in views}
    if others := [file for file in image_files(folder) if file not in named]:
        notes.append(f"Left out {len(others)} of the images, not named by row and column: {listed(others)}.")
    suffixes = sorted({view.file.suffix.lower() for view in views})
    if len(suffixes) > 1:
        notes.append(f"The views are of different kinds: {', '.join(suffixes)}.")
    start, shape = _grid(views)
    notes.append(_numbering(start, shape))
    return read_grid(
        by_place(((view.row - start[0], view.column - start[1]), view.file) for view in views),
        shape,
        folder=path,
        allow_missing=allow_missing,
        notes=notes,
    )


def _named_views(folder: Path) -> list[_NamedView]:
    matches = ((file, _NAME.fullmatch(file.stem)) for file in image_files(folder))
    return [_NamedView(file, int(m[2]), int(m[4]), (m[1], m[3], m[5])) for file, m in matches if m]


def _folder_with_views(path: Path) -> tuple[Path, list[str]]:
    if _named_views(path):
        return path, []
    folders = [folder for folder in sub_folders(path) if _named_views(folder)]
    if not folders:
        raise LightFieldError(
            f"{path} has no images named by row and column, such as view_00_03.png; give the folder that holds them."
        )
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise LightFieldError(f"{path} has several folders with images named by row and column ({names}); give one.")
    return folders[0], [f"The views are in the folder {folders[0].name}."]


def _check_one_scene(views: list[_NamedView]) -> None:
    first = views[0]
    for view in views[1:]:
        if view.text != first.text:
            raise LightFieldError(
                f"{view.file.parent} has images named in different ways: {first.file.name} and {view.file.name}; the "
                "last two numbers are row and column, the rest must be the same: move what is no view elsewhere."
            )


def _grid(views: list[_NamedView]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The numbers that the first row and column bear, and how many of each there are.

    Both axes count from the same number, so that a lost first row is noticed. An axis along which the cameras do not
    stand (one row or one column of views) is left out of that.
    """
    axes = [{view.row for view in views}, {view.column for view in views}]
    lowest = min((min(axis) for axis in axes if len(axis) > 1), default=0)
    row, column = (lowest if len(axis) > 1 else min(axis) for axis in axes)
    return (row, column), (max(axes[0]) - row + 1, max(axes[1]) - column + 1)


def _numbering(start: tuple[int, int], shape: tuple[int, int]) -> str:
    row, column = start
    if shape[0] == 1:
        return f"All views are in row {row} of the file names, which count columns from {column}."
    if shape[1] == 1:
        return f"All views are in column {column} of the file names, which count rows from {row}."
    return f"The file names count rows and columns from {row}."
