"""One picture of all views side by side, rows x columns of them (contact sheets, quilts)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.data.reading import Reading
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import ASK_FOR_GRID, grid_field
from lfgpu.io.folders import IMAGE_SUFFIXES
from lfgpu.io.images import read_view
from lfgpu.io.parallax import shrunk

_MOST = 32  # views along a side that are looked for
_ALIKE = 0.7  # correlation of neighbouring views; that of parts of one picture is 0.5 at most, as a rule
_MORE = 0.2  # how much more than with half of a view in between
_SMALLEST = 8  # reduced pixels along the side of a view that is looked for


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a picture of views side by side; None if it is not."""
    if path.suffix.lower() not in IMAGE_SUFFIXES or "tiles" not in path.stem.lower() or not path.is_file():
        return None
    return "it is an image with tiles in its name"


def read_tiles(path: Path, *, grid: tuple[int, int] | None = None) -> LightField:
    """Read an image of rows x columns views side by side, from the top left.

    `grid` is (rows, columns); None finds them: neighbouring views look alike.
    """
    image, valid, _ = read_view(path)
    why = "views side by side in one picture"
    if grid is None:
        grid = tiles_in(image)
        if grid is None:
            raise LightFieldError(f"{path} shows no views side by side that look alike; {ASK_FOR_GRID}.")
        why += f", {grid[0]} x {grid[1]} (rows x columns) of which look alike"
    rows, columns = grid
    if image.shape[0] % rows or image.shape[1] % columns:
        raise LightFieldError(
            f"{path} has {image.shape[1]} x {image.shape[0]} pixels, which a grid of {rows} x {columns} views does not "
            "fill; give another grid."
        )
    mask = None if valid is None or valid.all() else _cut(valid[..., None], rows, columns)[..., 0]
    return grid_field(path, _cut(image, rows, columns), valid=mask, reading=Reading(why))


def tiles_in(image: NDArray[Any], *, factor: int = 4) -> tuple[int, int] | None:
    """Find (rows, columns) of the views that a picture [y, x, c] shows side by side; None if it shows none.

    It is looked at `factor` times smaller, so that patterns of fewer pixels say nothing.
    """
    grey = shrunk(image.mean(axis=2, dtype=np.float64), factor) if min(image.shape[:2]) >= 4 * factor else None
    if grey is None:
        return None
    rows, columns = _count(grey, image.shape[0]), _count(grey.T, image.shape[1])
    return None if rows * columns == 1 else (rows, columns)


def _count(grey: NDArray[np.float64], side: int) -> int:
    """Find the largest number of parts of a picture along its first axis that look like their neighbours; 1 if none."""
    for count in range(min(_MOST, len(grey) // _SMALLEST), 1, -1):
        if side % count == 0:
            step = round(len(grey) / count)
            alike = _alike(grey, step)
            if alike > _ALIKE and alike > _alike(grey, step // 2) + _MORE:  # smooth pictures resemble themselves nearby
                return count
    return 1


def _alike(grey: NDArray[np.float64], step: int) -> float:
    """Correlation of a picture with itself, moved along its first axis."""
    a, b = grey[:-step], grey[step:]
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1]) if a.std() > 0 and b.std() > 0 else 0.0


def _cut(image: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    """Cut a picture [y, x, c] into views [v, u, y, x, c]."""
    height, width = image.shape[0] // rows, image.shape[1] // columns
    return np.ascontiguousarray(image.reshape(rows, height, columns, width, image.shape[2]).transpose(0, 2, 1, 3, 4))
