"""One TIFF file of many pages, a view each (extra `tiff`)."""

import logging
import math
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField, Reading
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import arranged, grid_field
from lfgpu.io.damage import check_claim, read_as, require
from lfgpu.io.tiff_pages import check_pages, numbers, pages

_PLANES = 3  # pages of a view, if each is a colour
_COLOURS = 4  # samples of a pixel; more are views
_ORIENTATION, _SAMPLES = 274, 277  # tags


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a TIFF of several pages; None if it is not."""
    if path.suffix.lower() not in (".tif", ".tiff") or not path.is_file():
        return None
    found: list[int] = []
    try:
        found.extend(islice(pages(path), 2))
    except LightFieldError:  # linked in a circle, which who reads it says
        found = [0, 0]
    if len(found) == 1 and (planes := numbers(path, found[0]).get(_SAMPLES, 0)) > _COLOURS:
        return f"it is a TIFF file of {planes} planes"
    return "it is a TIFF file of several pages" if len(found) > 1 else None


def read_tiff_stack(path: Path, *, grid: tuple[int, int] | None = None, axes: str | None = None) -> LightField:
    """Read a TIFF of which each page is a view of uint8, uint16 or float32, grey or RGB (extra `tiff`).

    Views stand row by row in the `grid` that is given, else as the file's own description says (tifffile and ImageJ
    write it for arrays), else in a square. `axes` is the order of the axes of the pages, such as "ncyx"; None takes
    what the file says. Pages that are planes of colours are "ncyx"; "cnyx" if all views of a colour come together.
    """
    if not path.is_file():
        raise LightFieldError(f"{path} is not a TIFF file of several pages.")
    tifffile = require("tifffile", "tiff", path)
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it logs of damaged files is raised below as well
    with read_as(path, "a TIFF file"):
        check_pages(path)
        with tifffile.TiffFile(path) as file:
            array, named = _pages(path, file, as_stored=axes is not None)
    views, why = arranged(path, _unfolded(path, array, grid, axes), grid, axes or named)
    if axes is None and named is not None:
        why = why.replace("as told", "as the file names them", 1)
    return grid_field(path, views, reading=Reading(why))


def _pages(path: Path, file: Any, *, as_stored: bool) -> tuple[NDArray[Any], str | None]:
    """Return all pages as one array, and its axes in the letters of `arranged` where the file names them."""
    series = list(file.series)
    if len(series) > 1 and all((s.shape, s.dtype) == (series[0].shape, series[0].dtype) for s in series):
        check_claim(path, (len(series), *series[0].shape), series[0].dtype)  # pages that were appended one by one
        _check_whole(path, file)
        return np.stack([s.asarray() for s in series]), None
    if len(series) != 1:
        raise LightFieldError(f"{path} has pages that are not alike; a light field has views of one size and type.")
    one = series[0]
    if one.dtype is None or len(one.shape) < 3:
        raise LightFieldError(f"{path} has one page only; a light field has a page for each view.")
    check_claim(path, one.shape, one.dtype)
    _check_whole(path, file)
    array, axes = np.asarray(one.asarray()), _axes(one)
    samples = one.axes.find("S")
    if axes is None and not as_stored and 0 <= samples < array.ndim - 1:
        array = np.moveaxis(array, samples, -1)
    return array, axes


def _unfolded(path: Path, array: NDArray[Any], grid: tuple[int, int] | None, axes: str | None) -> NDArray[Any]:
    """Split pages [n, y, x] that are planes of colours as `axes` says; ask for it where `grid` shows that."""
    count = math.prod(grid or (0,)) or len(array) // _PLANES
    if array.ndim != 3 or len(array) != _PLANES * count:
        return array
    if grid is not None and axes is None:
        raise LightFieldError(
            f"{path} has {len(array)} pages, {_PLANES} times the {count} views of a grid of {grid[0]} x {grid[1]}: if "
            "they are colours, say --axes ncyx if those of a view follow each other, or --axes cnyx if all views of a "
            "colour do (axes= in Python)."
        )
    if axes in ("ncyx", "cnyx"):
        return array.reshape([count if axis == "n" else _PLANES for axis in axes[:2]] + [*array.shape[1:]])
    return array


def _axes(series: Any) -> str | None:
    """Return the axes of pages in the letters of `arranged`; None where the file does not name any."""
    named = series.axes
    if not {"Y", "X"} <= set(named) or "Q" in named or len(set(named)) < len(named):
        return None
    size = dict(zip(named, series.shape, strict=True))
    colour = "S" if "S" in named else "C"
    views = [axis for axis in named if axis not in ("Y", "X", colour)]
    if size.get(colour, 1) not in (1, 3, 4):
        views = [axis for axis in named if axis not in "YX"]
        colour = ""
    if len(views) not in (1, 2):
        return None
    letters = dict(zip(views, "n" if len(views) == 1 else "vu", strict=True))
    return "".join(letters.get(axis) or ("c" if axis == colour else axis.lower()) for axis in named)


def _check_whole(path: Path, file: Any) -> None:
    tags = file.pages.first.tags
    if _ORIENTATION in tags and tags[_ORIENTATION].value != 1:
        raise LightFieldError(f"{path} has pages that are stored turned (orientation); save them upright.")
    end = path.stat().st_size
    for page in file.pages:
        spans = zip(page.dataoffsets, page.databytecounts, strict=True)
        if any(offset + count > end for offset, count in spans):
            raise LightFieldError(f"{path} is cut short: its pixels are said to go on beyond its end.")
