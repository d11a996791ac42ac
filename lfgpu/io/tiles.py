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
from lfgpu.io.sheets import block_in, tiles_in


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
    elif tiles_in(image) is None and block_in(image) != (None, None):
        raise LightFieldError(
            f"{path} shows no views side by side, but pixels of all views under each microlens: read it with --format "
            "mosaic (format= in Python)."
        )
    rows, columns = grid
    if image.shape[0] % rows or image.shape[1] % columns:
        raise LightFieldError(
            f"{path} has {image.shape[1]} x {image.shape[0]} pixels, which a grid of {rows} x {columns} views does not "
            "fill; give another grid."
        )
    mask = None if valid is None or valid.all() else _cut(valid[..., None], rows, columns)[..., 0]
    return grid_field(path, _cut(image, rows, columns), valid=mask, reading=Reading(why))


def _cut(image: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    """Cut a picture [y, x, c] into views [v, u, y, x, c]."""
    height, width = image.shape[0] // rows, image.shape[1] // columns
    return np.ascontiguousarray(image.reshape(rows, height, columns, width, image.shape[2]).transpose(0, 2, 1, 3, 4))
