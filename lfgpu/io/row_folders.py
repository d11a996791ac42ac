"""Folders of folders: one for each row of cameras, with numbered images in it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.camera_row import numbered_images
from lfgpu.io.folders import sub_folders
from lfgpu.io.grid import Place, by_place, read_grid
from lfgpu.io.images import read_image

_ROW = re.compile(r"(?:|r|row|v|y|line)[-_ ]?([0-9]{1,3})", re.IGNORECASE)
_SIDE = 24  # pixels to which views are shrunk to be compared
_ALIKE = 0.7  # correlation of neighbouring rows; other scenes are below it, as a rule


def recognise(path: Path) -> str | None:
    """Why a path is taken for a folder of rows; None if it is not."""
    if not path.is_dir():
        return None
    rows = _rows(path)
    if len(rows) < 2 or len({len(images) for _, _, images in rows}) > 1:
        return None
    return f"its folders {rows[0][1].name} ... {rows[-1][1].name} are rows of views" if _one_scene(rows) else None


def read_row_folders(path: Path, *, allow_missing: bool = False) -> LightField:
    """Read a folder that has a folder for each row of cameras, from top to bottom; images count from left to right.

    Parameters
    ----------
    path
        The folder. Those in it are named by a number, such as 00 or row_3; the images in each are named alike but for
        one number.
    allow_missing
        Whether a grid that seems to have lost some views is accepted.

    Raises
    ------
    LightFieldError
        If there are no such folders, views are missing or damaged.
    """
    rows = _rows(path)
    if len(rows) < 2:
        raise LightFieldError(f"{path} has no folders named by a number with numbered images in each.")
    first_row = rows[0][0]
    first = min(number for _, _, images in rows for number, _ in images)
    last = max(number for _, _, images in rows for number, _ in images)
    shape = (rows[-1][0] - first_row + 1, last - first + 1)
    if shape[1] > 1000:
        raise LightFieldError(f"{path} has images numbered from {first} to {last}; that is no row of cameras.")
    places: list[tuple[Place, Path]] = [
        ((row - first_row, number - first), file) for row, _, images in rows for number, file in images
    ]
    note = f"Each folder is a row, counted from {first_row} downwards; images count columns from {first} on."
    return read_grid(by_place(places), shape, folder=path, allow_missing=allow_missing, notes=[note])


_Row = tuple[int, Path, list[tuple[int, Path]]]


def _rows(path: Path) -> list[_Row]:
    """(number, folder, its numbered images) of each row, by number."""
    matches = [(folder, match) for folder in sub_folders(path) if (match := _ROW.fullmatch(folder.name))]
    rows = [(int(match[1]), folder, numbered_images(folder)) for folder, match in matches]
    return sorted((row for row in rows if len(row[2]) > 1), key=lambda row: row[:2])


def _one_scene(rows: Sequence[_Row]) -> bool:
    """Whether the middle views of all rows show the same scene: folders of other scenes are often numbered, too."""
    try:
        views = [_small(images[len(images) // 2][1]) for _, _, images in rows]
    except LightFieldError:  # whoever reads them says what is wrong
        return True
    return all(float((a * b).mean()) > _ALIKE for a, b in pairwise(views))


def _small(file: Path) -> NDArray[np.float64]:
    """A view, shrunk and grey, with mean 0 and variance 1."""
    image, _ = read_image(file)
    grey = Image.fromarray(image.mean(axis=2, dtype=np.float32))
    values = np.asarray(grey.resize((_SIDE, _SIDE), Image.Resampling.BOX), np.float64)
    values = values - values.mean()
    return np.asarray(values / max(float(values.std()), 1e-9))
