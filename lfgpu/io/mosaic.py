"""One picture of all microlenses, each a block of rows x columns pixels of which one belongs to each view (ESLF)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import grid_field
from lfgpu.io.folders import IMAGE_SUFFIXES
from lfgpu.io.images import read_image
from lfgpu.io.sheets import block_in, tiles_in
from lfgpu.io.vignette import lit

_STANFORD = (14, 14)  # of the Stanford Lytro archive, whose files are named ..._eslf.png


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a mosaic of microlenses; None if it is not."""
    if path.suffix.lower() not in IMAGE_SUFFIXES or "eslf" not in path.stem.lower() or not path.is_file():
        return None
    return "it is an image with ESLF in its name"


def read_mosaic(path: Path, *, grid: tuple[int, int] | None = None) -> LightField:
    """Read an image in which pixel (v, u) of block (y, x) is pixel (y, x) of view (v, u).

    Such are ESLF files of the Stanford Lytro archive and exports of Lytro's software, grey or colour. Views in the
    corners of the blocks are dark where the main lens vignettes: those pixels are marked as not valid, and views that
    are all dark are left out.

    `grid` is (rows, columns) of a block; None takes 14 x 14 for files named ESLF that this divides, and looks for the
    block in the picture otherwise.
    """
    image, _ = read_image(path)
    notes = []
    rows, columns = block_in(image)
    if grid is not None:
        if (rows or grid[0], columns or grid[1]) != tuple(grid):
            notes.append(
                f"By its pixels, blocks of {rows or grid[0]} x {columns or grid[1]} repeat in the picture, not the "
                f"{grid[0]} x {grid[1]} of the grid."
            )
    elif recognise(path) and _divides(_STANFORD, image):
        grid = _STANFORD
    else:
        grid = None if rows is None or columns is None else (rows, columns)
        if grid is None and (side_by_side := tiles_in(image)) is not None:
            raise LightFieldError(_side_by_side(path, side_by_side))
        if grid is None:
            raise LightFieldError(
                f"{path} does not look like a mosaic of views: no block of pixels repeats in it; if it is one, say how "
                "many views it has: grid=(rows, columns), --grid ROWSxCOLUMNS on the command line."
            )
        notes.append(f"Each microlens is taken for a block of {grid[0]} x {grid[1]} pixels (rows x columns).")
    if (side_by_side := tiles_in(image, factor=max(grid))) is not None:
        raise LightFieldError(_side_by_side(path, side_by_side))
    rows, columns = grid
    height, width = image.shape[0] // rows if rows > 0 else 0, image.shape[1] // columns if columns > 0 else 0
    if height < 2 or width < 2:
        raise LightFieldError(
            f"{path} has {image.shape[1]} x {image.shape[0]} pixels; they do not hold {rows} x {columns} views."
        )
    if not _divides(grid, image):
        notes.append("Pixels at the right and the bottom that do not fill a block were left out.")
    blocks = image[: height * rows, : width * columns].reshape(height, rows, width, columns, image.shape[2])
    views = np.ascontiguousarray(blocks.transpose(1, 3, 0, 2, 4))
    light_field = grid_field(path, views)
    return replace(
        grid_field(path, views, valid=lit(light_field).reshape(views.shape[:4]), notes=notes), reference=None
    )


def _side_by_side(path: Path, shape: tuple[int, int]) -> str:
    return (
        f"{path} shows views side by side, not pixels of all views under each microlens: read it with --format tiles "
        f"--grid {shape[0]}x{shape[1]} (format= and grid= in Python)."
    )


def _divides(grid: tuple[int, int], image: NDArray[Any]) -> bool:
    return image.shape[0] % grid[0] == 0 and image.shape[1] % grid[1] == 0
