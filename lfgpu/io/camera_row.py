"""Folders of numbered images: a camera that moved along a row, or a grid of cameras numbered row by row."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import grid_shape
from lfgpu.io.folders import image_files, listed, sub_folders
from lfgpu.io.grid import by_place, read_grid

_NAME = re.compile(r"(.*?)([0-9]{1,9})([^0-9]*)", re.DOTALL)
_MOST = 10_000  # places of a row


def recognise(path: Path) -> str | None:
    """Why a path is taken for a folder of numbered images; None if it is not."""
    if not path.is_dir():
        return None
    if len(views := numbered_images(path)) > 1:
        return f"it is a folder with numbered images, such as {views[0][1].name}"
    folders = [folder for folder in sub_folders(path) if len(numbered_images(folder)) > 1]
    return f"its folder {folders[0].name} has numbered images" if folders else None


def read_camera_row(
    path: Path, *, allow_missing: bool = False, grid: tuple[int, int] | None = None, every: int | None = None
) -> LightField:
    """Read images that are named alike but for one number: a row of cameras, or one camera that moved to the right.

    Parameters
    ----------
    path
        The folder, or one with exactly one sub-folder of such images.
    allow_missing
        Whether gaps between the numbers are accepted as missing views. (A constant step between them is no gap.)
    grid
        (rows, columns) of cameras that are numbered row by row; (n, 1) is a camera that moved down. None is a row; for
        4, 9, 16, 25 ... images, which may as well be a square, it has to be said.
    every
        Take one image of so many, from the first on; None takes all.

    Raises
    ------
    LightFieldError
        If there are no such images, they leave open how they stand, or they are damaged.
    """
    folder = _folder(path)
    views = numbered_images(folder)
    notes = [] if folder == path else [f"The views are in the folder {folder.name}."]
    named = {file for _, file in views}
    if others := [file for file in image_files(folder) if file not in named]:
        notes.append(f"Left out {len(others)} of the images, not named as the others: {listed(others)}.")
    first = views[0][0]
    step = math.gcd(*(number - first for number, _ in views)) or 1
    if (views[-1][0] - first) // step >= _MOST:
        raise LightFieldError(
            f"{folder} has images numbered from {first} to {views[-1][0]}; that is no row of cameras."
        )
    chosen = [((number - first) // step, file) for number, file in views]
    if every is not None:
        chosen = [(place // every, file) for place, file in chosen if place % every == 0]
    last = chosen[-1][0] + 1
    if grid is None and len(chosen) == last and last >= 9 and math.isqrt(last) ** 2 == last:
        side = math.isqrt(last)
        raise LightFieldError(
            f"{path} has {last} numbered images, in one row or in a square: say which with grid=(1, {last}) or "
            f"grid=({side}, {side}), --grid 1x{last} or --grid {side}x{side} on the command line."
        )
    shape = (1, last) if grid is None else grid_shape(path, last, grid)
    if shape[0] == 1:
        notes.append("Taken for a camera that moved to the right in equal steps as the numbers rise.")
    places = by_place((divmod(place, shape[1]), file) for place, file in chosen)
    return read_grid(places, shape, folder=path, allow_missing=allow_missing, notes=notes)


def numbered_images(folder: Path) -> list[tuple[int, Path]]:
    """(number, file) of the images of the most frequent name, by number."""
    matches = [(file, match) for file in image_files(folder) if (match := _NAME.fullmatch(file.stem))]
    kinds = Counter((match[1], match[3]) for _, match in matches)
    if not kinds:
        return []
    kind = kinds.most_common(1)[0][0]
    return sorted((int(match[2]), file) for file, match in matches if (match[1], match[3]) == kind)


def _folder(path: Path) -> Path:
    if not path.is_dir():
        raise LightFieldError(f"{path} is not a folder of numbered images.")
    if len(numbered_images(path)) > 1:
        return path
    folders = [folder for folder in sub_folders(path) if len(numbered_images(folder)) > 1]
    if not folders:
        raise LightFieldError(f"{path} has no numbered images, such as view_0012.png; give the folder that holds them.")
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise LightFieldError(f"{path} has several folders with numbered images ({names}); give one.")
    return folders[0]
