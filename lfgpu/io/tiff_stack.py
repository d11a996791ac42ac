"""One TIFF file of many pages, a view each (extra `tiff`)."""

from __future__ import annotations

import logging
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import arranged, grid_field
from lfgpu.io.extras import require
from lfgpu.io.limits import check_claim
from lfgpu.io.tiff_pages import check_pages, pages


def recognise(path: Path) -> str | None:
    """Why a path is taken for a TIFF of several pages; None if it is not."""
    if path.suffix.lower() not in (".tif", ".tiff") or not path.is_file():
        return None
    try:
        several = len(list(islice(pages(path), 2))) == 2
    except LightFieldError:  # linked in a circle, which who reads it says
        several = True
    return "it is a TIFF file of several pages" if several else None


def read_tiff_stack(path: Path, *, allow_missing: bool = False, grid: tuple[int, int] | None = None) -> LightField:
    """Read a TIFF of which each page is a view, row by row.

    Parameters
    ----------
    path
        The file; pages of uint8, uint16 or float32, grey or RGB.
    allow_missing
        Not needed.
    grid
        (rows, columns); None takes what the file's own description says (as tifffile and ImageJ write it for arrays),
        or a square.

    Raises
    ------
    LightFieldError
        If tifffile is missing, the file is damaged, or its pages are not alike.
    """
    if not path.is_file():
        raise LightFieldError(f"{path} is not a TIFF file of several pages.")
    tifffile = require("tifffile", "tiff", path)
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it logs of damaged files is raised below as well
    try:
        check_pages(path)
        with tifffile.TiffFile(path) as file:
            array = _pages(path, file)
    except LightFieldError:
        raise
    except Exception as error:  # tifffile raises whatever comes to it when a file is damaged
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise LightFieldError(f"{path} cannot be read as a TIFF file: {reason}.") from error
    views, notes = arranged(path, array, grid)
    return grid_field(path, views, notes=notes)


def _pages(path: Path, file: Any) -> NDArray[Any]:
    if len(file.series) != 1:
        raise LightFieldError(f"{path} has pages that are not alike; a light field has views of one size and type.")
    series = file.series[0]
    if len(series.shape) < 3 or series.dtype is None:
        raise LightFieldError(f"{path} has one page only; a light field has a page for each view.")
    check_claim(path, series.shape, series.dtype)
    end = path.stat().st_size
    for page in file.pages:
        spans = zip(page.dataoffsets, page.databytecounts, strict=True)
        if any(offset + count > end for offset, count in spans):
            raise LightFieldError(f"{path} is cut short: its pixels are said to go on beyond its end.")
    array = np.asarray(series.asarray())
    samples = series.axes.find("S")
    return np.moveaxis(array, samples, -1) if 0 <= samples < array.ndim - 1 else array
