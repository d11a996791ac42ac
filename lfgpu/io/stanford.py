"""The (New) Stanford Light Field Archive: rectified views named out_ROW_COLUMN_Y_X.png after where the camera stood."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.damage import naming
from lfgpu.io.flips import flipped
from lfgpu.io.folders import image_files, listed, sub_folders
from lfgpu.io.parallax import axes_agree
from lfgpu.io.views import load_views

_NUMBER = r"(-?[0-9]{1,9}(?:\.[0-9]{1,12})?)"
_NAME = re.compile(rf"(?:.*_)?([0-9]{{1,3}})_([0-9]{{1,3}})_{_NUMBER}_{_NUMBER}_?", re.DOTALL)


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a folder of the archive; None if it is not."""
    if not path.is_dir():
        return None
    folder = folder_of(path)
    return None if folder is None else f"it has images named out_ROW_COLUMN_Y_X, such as {_views(folder)[0][0].name}"


def read_stanford(path: Path) -> LightField:
    """Read a folder of views that are named by row, column and position of the camera, or a folder that holds it.

    Positions are irregular, in the unit of the gantry. They become view steps by the median distance of neighbours in a
    row (in a column where there is one only); both axes have the same unit, so that disparities mean the same on both.
    X counts to the right and Y downwards, whatever the rows and columns of the names do; where the pictures tell
    otherwise of Y they are followed, with a note.
    """
    folder = folder_of(path)
    if folder is None:
        raise LightFieldError(f"{path} has no images named out_ROW_COLUMN_Y_X.png; give the folder that holds them.")
    named = _views(folder)
    if len(named) < 2:
        raise LightFieldError(f"{folder} has one view only ({named[0][0].name}); depth needs at least two.")
    files = [file for file, _ in named]
    notes = [] if folder == path else [f"The views are in the folder {folder.name}."]
    if others := sorted(set(image_files(folder)) - set(files)):
        notes.append(f"Left out {len(others)} of the images, not named by position: {listed(others)}.")
    rows, columns, y, x = np.array([[float(match[group]) for group in (1, 2, 3, 4)] for _, match in named]).T
    step = _step(x, rows, columns) or _step(y, columns, rows)
    if step is None:
        raise LightFieldError(f"{folder}: all cameras stand in one place by the names of their images.")
    positions = np.stack([x, y], axis=1) / step
    positions -= positions.min(axis=0)
    views, valid, image_notes = load_views(files)
    with naming(folder):
        light_field = LightField(views, positions, valid=valid, name=path.resolve().name, files=tuple(map(str, files)))
    notes.append(f"One view step is {step:.6g} in the unit of the names, the median distance of neighbours.")
    if axes_agree(light_field) is False:
        light_field = flipped(light_field, "v")
        notes.append("By its pictures Y counts the other way than its names say; rows were turned round.")
    return replace(light_field, notes=(*notes, *image_notes))


def _views(folder: Path) -> list[tuple[Path, re.Match[str]]]:
    matches = ((file, _NAME.fullmatch(file.stem)) for file in image_files(folder))
    return [(file, match) for file, match in matches if match]


def folder_of(path: Path) -> Path | None:
    """Return the folder with the views: the path or one in it; None if there is none."""
    if not path.is_dir():
        return None
    return next((folder for folder in (path, *sub_folders(path)) if _views(folder)), None)


def _step(along: NDArray[np.float64], line: NDArray[np.float64], place: NDArray[np.float64]) -> float | None:
    """Median distance between neighbouring places of one line; None where no line has two."""
    steps = []
    for number in np.unique(line):
        order = np.argsort(place[line == number])
        places, values = place[line == number][order], along[line == number][order]
        gaps = np.diff(places)
        steps += list(np.abs(np.diff(values))[gaps > 0] / gaps[gaps > 0])
    found = float(np.median(steps)) if steps else 0.0
    return found if found > 0 else None
