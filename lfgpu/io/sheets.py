"""One picture that holds all views: side by side, or a pixel of each view under every microlens (ESLF)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField, Reading
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import ASK_FOR_GRID, grid_field
from lfgpu.io.brightness import without_dark_parts
from lfgpu.io.folders import IMAGE_SUFFIXES
from lfgpu.io.images import read_view
from lfgpu.io.parallax import SMALLEST, alike, shrunk

_MOST = 32  # views along a side that are looked for
_ALIKE = 0.7  # correlation of neighbouring views; that of parts of one picture is 0.5 at most, as a rule
_ALIKE_PERHAPS = 0.4  # correlation of neighbouring views that move far, or one of which is upside down
_MORE = 0.2  # how much more than with half of a view in between
_SMALLEST = 8  # reduced pixels along the side of a view that is looked for

_LEAST, _LARGEST = 2, 32  # blocks that are looked for
_EXPLAINED = 0.25  # share of the variation of neighbouring differences that repeats with the blocks: 0.9 in real
# mosaics, 0.2 at most in pictures
_NEARLY = 0.85  # of the best share: multiples of the block explain as much as the block


def tiles_in(image: NDArray[Any], *, factor: int = 4) -> tuple[int, int] | None:
    """Find (rows, columns) of views side by side in a picture, `factor` times smaller; None if it does not tell."""
    grey = shrunk(image.mean(axis=2, dtype=np.float64), factor) if min(image.shape[:2]) >= 4 * factor else None
    if grey is None:
        return None
    rows, columns = _count(grey, image.shape[0]), _count(grey.T, image.shape[1])
    return None if rows is None or columns is None or rows * columns == 1 else (rows, columns)


def _count(grey: NDArray[np.float64], side: int) -> int | None:
    """Find the largest number of parts of a picture along its first axis that look like their neighbours; 1 if none do,
    None if some may."""
    found: int | None = 1
    for count in range(min(_MOST, len(grey) // _SMALLEST), 1, -1):
        if side % count == 0:
            step = round(len(grey) / count)
            alike = _alike(grey, step)
            if alike < _ALIKE_PERHAPS or alike < _alike(grey, step // 2) + _MORE:  # smooth pictures resemble themselves
                continue
            if alike > _ALIKE:
                return None if _shows_views(grey[:step], side // count) else count
            found = None
    return found


def _shows_views(grey: NDArray[np.float64], side: int) -> bool:
    """Tell whether a part of a picture has parts along its first axis two of which are alike: others may be upside
    down."""
    for count in range(2, len(grey) // _SMALLEST + 1):
        step = len(grey) // count
        for start in range(0, len(grey) - 2 * step + 1, step) if side % count == 0 else ():
            pair = grey[start : start + 2 * step]
            if _alike(pair, step) > max(_ALIKE, _alike(pair, step // 2) + _MORE):
                return True
    return False


def _alike(grey: NDArray[np.float64], step: int) -> float:
    """Correlation of a picture with itself, moved along its first axis."""
    return alike(grey[:-step], grey[step:])


def block_in(image: NDArray[Any]) -> tuple[int | None, int | None]:
    """Find (rows, columns) of the block under a microlens, with which differences of pixels repeat, or None."""
    grey = image.mean(axis=2, dtype=np.float32)
    return _period(np.abs(np.diff(grey, axis=0)).mean(axis=1)), _period(np.abs(np.diff(grey)).mean(axis=0))


def _period(profile: NDArray[np.float32]) -> int | None:
    """Find the smallest period that explains nearly as much of a profile as the best one; None if that is little."""
    length = len(profile) + 1
    if length < SMALLEST * _LEAST or not profile.mean() > 0:
        return None
    # In logarithms, and without the mean of each cycle, so that the picture itself counts less.
    levels = np.append(np.log(profile + 1e-3 * profile.mean()), np.nan)
    explained = {}
    for period in range(_LEAST, _LARGEST + 1):
        if length % period == 0 and length >= SMALLEST * period:
            cycles = levels.reshape(-1, period)
            cycles = cycles - np.nanmean(cycles, axis=1, keepdims=True)
            share = float(np.nanmean(cycles, axis=0).var() / max(float(np.nanvar(cycles)), 1e-12))
            explained[period] = 1 - (1 - share) * len(cycles) / (len(cycles) - 1)  # of few cycles more is chance
    best = max(explained.values(), default=0.0)
    return None if best < _EXPLAINED else next(p for p, share in explained.items() if share >= _NEARLY * best)


def recognise(path: Path, word: str) -> str | None:
    """Say why a path is taken for a picture of all views, by a word in its name; None if it is not."""
    if path.suffix.lower() not in IMAGE_SUFFIXES or word.lower() not in path.stem.lower() or not path.is_file():
        return None
    return f"it is an image with {word} in its name"


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


ESLF = "ESLF"
_STANFORD = (14, 14)  # of the Stanford Lytro archive, whose files are named ..._eslf.png


def read_mosaic(path: Path, *, grid: tuple[int, int] | None = None) -> LightField:
    """Read an image in which pixel (v, u) of block (y, x) is pixel (y, x) of view (v, u).

    Such are ESLF files of the Stanford Lytro archive and exports of Lytro's software, grey or colour. Views in the
    corners of the blocks are dark where the main lens vignettes: those pixels are marked as not valid, and views that
    are all dark are left out.

    `grid` is (rows, columns) of a block; None takes 14 x 14 for files named ESLF that this divides, and looks for the
    block in the picture otherwise.
    """
    image, valid, _ = read_view(path)
    notes = []
    rows, columns = block_in(image)
    if grid is not None:
        if (rows or grid[0], columns or grid[1]) != tuple(grid):
            notes.append(
                f"By its pixels, blocks of {rows or grid[0]} x {columns or grid[1]} repeat in the picture, not the "
                f"{grid[0]} x {grid[1]} of the grid."
            )
    elif recognise(path, ESLF) and _divides(_STANFORD, image):
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

    def of_views(picture: NDArray[Any]) -> NDArray[Any]:
        blocks = picture[: height * rows, : width * columns].reshape(height, rows, width, columns, -1)
        return np.ascontiguousarray(blocks.transpose(1, 3, 0, 2, 4))

    mask = None if valid is None or valid.all() else of_views(valid)[..., 0]
    return without_dark_parts(path, grid_field(path, of_views(image), valid=mask, notes=notes))


def _side_by_side(path: Path, shape: tuple[int, int]) -> str:
    return (
        f"{path} shows views side by side, not pixels of all views under each microlens: read it with --format tiles "
        f"--grid {shape[0]}x{shape[1]} (format= and grid= in Python)."
    )


def _divides(grid: tuple[int, int], image: NDArray[Any]) -> bool:
    return image.shape[0] % grid[0] == 0 and image.shape[1] % grid[1] == 0
