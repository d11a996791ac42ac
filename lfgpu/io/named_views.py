"""Folders of images whose names end in row and column: view_00_03.png, 5_5.bmp, r2c5.png, image_+1_-4.tif."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import image_files, listed, sub_folders
from lfgpu.io.grid import by_place, read_grid
from lfgpu.io.images import image_size

# The last two numbers of a name. Row and column have at most three digits, so that dates and times are none.
_NAME = re.compile(r"(.*?)(?<![0-9])([0-9]{1,3})([^0-9]+)([0-9]{1,3})([^0-9]*)", re.DOTALL)
_SIGN = re.compile(r"(.*?(?:^|[^0-9A-Za-z+-]))([+-])", re.DOTALL)  # at the end of what stands before a number


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
    one tells, or have signs (image_+1_-4.tif). Images named otherwise are left out, with a note. If the folder itself
    has no such images but exactly one of its direct sub-folders has, that one is read.

    Parameters
    ----------
    path
        The folder.
    allow_missing
        Whether a grid that seems to have lost some views is accepted, and views of another size than most are left out.

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
    sizes = {view.file: image_size(view.file) for view in views}
    frequent = Counter(size for size in sizes.values() if size is not None).most_common()
    if len(frequent) > 1:
        views = _of_one_size(folder, views, sizes, frequent, notes, allow_missing=allow_missing)
    suffixes = sorted({view.file.suffix.lower() for view in views})
    if len(suffixes) > 1:
        notes.append(f"The views are of different kinds: {', '.join(suffixes)}.")
    start, shape = _grid(views)
    notes.append(_numbering(start, shape))
    light_field = read_grid(
        by_place(((view.row - start[0], view.column - start[1]), view.file) for view in views),
        shape,
        folder=path,
        allow_missing=allow_missing,
        notes=notes,
    )
    signed = min(start) < 0
    if signed and any((view.row, view.column) == (0, 0) for view in views):
        return light_field.with_reference(light_field.index_of(-start[0], -start[1]))
    return light_field


def _named_views(folder: Path) -> list[_NamedView]:
    matches = ((file, _NAME.fullmatch(file.stem)) for file in image_files(folder))
    plain = [_NamedView(file, int(m[2]), int(m[4]), (m[1], m[3], m[5])) for file, m in matches if m]
    signed = [_signed(view) for view in plain]
    return signed if _have_signs(signed) else plain


def _signed(view: _NamedView) -> _NamedView:
    """The same view if the characters before its numbers are signs of them."""
    before, between, after = view.text
    first, row = _sign(before, view.row)
    # A sign follows something else than the number before it: "1_-2", but not "1-2".
    second, column = _sign(between, view.column) if len(between) > 1 else (between, view.column)
    return _NamedView(view.file, row, column, (first, second, after))


def _sign(text: str, number: int) -> tuple[str, int]:
    """A text without the sign at its end, and the number that it stands before."""
    match = _SIGN.fullmatch(text)
    return (match[1], -number if match[2] == "-" else number) if match else (text, number)


def _have_signs(views: list[_NamedView]) -> bool:
    """Whether numbers have signs: there are some below zero, and a plus sign or numbers above zero as well.

    A minus alone may as well be a hyphen: "view_-01_-02".
    """
    axes = [[view.row for view in views], [view.column for view in views]]
    below = [axis for axis in axes if axis and min(axis) < 0]
    return bool(below) and (any("+" in view.file.stem for view in views) or all(max(axis) > 0 for axis in below))


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


def _of_one_size(
    folder: Path,
    views: list[_NamedView],
    sizes: Mapping[Path, tuple[int, int] | None],
    frequent: Sequence[tuple[tuple[int, int], int]],
    notes: list[str],
    *,
    allow_missing: bool,
) -> list[_NamedView]:
    """The views of the most frequent size, with a note; LightFieldError unless views may be missing."""
    chosen = frequent[0][0]
    others = [view.file for view in views if sizes[view.file] != chosen]
    found = " and ".join(f"{count} of {width} x {height}" for (height, width), count in frequent[:3])
    if not allow_missing:
        raise LightFieldError(
            f"the views in {folder} are not alike: there are {found} px, such as {listed(others)}; pass "
            "allow_missing=True (--allow-missing on the command line) to leave out all but the most frequent size."
        )
    notes.append(f"Left out {len(others)} of {len(views)} views, which are of another size: {listed(others)}.")
    return [view for view in views if sizes[view.file] == chosen]


def _grid(views: list[_NamedView]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The numbers that the first row and column bear, and how many of each there are.

    Both axes count from the same number, so that a lost first row is noticed, unless numbers have signs. An axis along
    which the cameras do not stand (one row or one column of views) is left out of that.
    """
    axes = [{view.row for view in views}, {view.column for view in views}]
    lowest = min((min(axis) for axis in axes if len(axis) > 1), default=0)
    row, column = (lowest if len(axis) > 1 and lowest >= 0 else min(axis) for axis in axes)
    return (row, column), (max(axes[0]) - row + 1, max(axes[1]) - column + 1)


def _numbering(start: tuple[int, int], shape: tuple[int, int]) -> str:
    row, column = start
    if shape[0] == 1:
        return f"All views are in row {row} of the file names, which count columns from {column}."
    if shape[1] == 1:
        return f"All views are in column {column} of the file names, which count rows from {row}."
    if row != column:
        return f"The file names count rows from {row} and columns from {column}."
    return f"The file names count rows and columns from {row}."
