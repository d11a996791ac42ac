"""Portable float maps: a short text header, then rows of float32 from the bottom up."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_write

# kind, width, height, scale; one white character, and the data begin
_HEADER = re.compile(rb"(P[Ff])\s+([0-9]{1,9})\s+([0-9]{1,9})\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?:\r\n|\s)")
_LONGEST = 256  # bytes of a header


def read_map(path: Path) -> DisparityMap:
    """Read a grey PFM as a map [y, x], top row first; a negative scale means little endian, its size is not applied.

    LightFieldError if it is not a PFM, is in colour, or holds less or more than its header says.
    """
    with path.open("rb") as file:
        header = _HEADER.match(file.read(_LONGEST))
    if header is None:
        raise LightFieldError(f"{path} is not a PFM file: it does not begin with 'Pf', width, height and scale.")
    if header[1] == b"PF":
        raise LightFieldError(f"{path} is a colour PFM ('PF'); a map has one value per pixel ('Pf').")
    width, height = int(header[2]), int(header[3])
    there = path.stat().st_size - header.end()
    if there != 4 * width * height or not there:
        raise LightFieldError(
            f"{path} is damaged: {width} x {height} float32 values are {4 * width * height} bytes, it has {there}."
        )
    if not float(header[4]):
        raise LightFieldError(f"{path} has the scale 0, whose sign cannot tell the order of its bytes; write it anew.")
    order = "<" if header[4].startswith(b"-") else ">"
    data = np.fromfile(path, f"{order}f4", width * height, offset=header.end())
    if len(data) != width * height:
        raise LightFieldError(f"{path} became shorter while it was read; try again.")
    values = np.flipud(data.reshape(height, width)).astype(np.float32, order="C")
    return DisparityMap(values, name=path.name)


def write_pfm(path: str | os.PathLike[str], values: ArrayLike) -> None:
    """Write a map [y, x] as a grey PFM, float32 and little endian, with NaN and infinities; whole or not at all."""
    array = np.asarray(values, np.float32)
    if array.ndim != 2 or 0 in array.shape:
        raise LightFieldError(f"{os.fspath(path)} cannot be written: a map must be [y, x], found shape {array.shape}.")
    with atomic_write(path) as temporary:
        write_map(DisparityMap(array), temporary)


def write_map(values: DisparityMap, path: Path, image: NDArray[Any] | None = None) -> None:
    """Write the values of a map to a path that is there to be written."""
    array = np.asarray(values.disparity, np.float32)
    header = f"Pf\n{array.shape[1]} {array.shape[0]}\n-1.0\n".encode()
    path.write_bytes(header + np.flipud(array).astype("<f4").tobytes())
