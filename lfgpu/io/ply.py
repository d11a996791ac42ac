"""PLY files of points: one element `vertex`, binary and little endian, each of its properties a number."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError

_FORMAT = "format binary_little_endian 1.0"
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8"},
}
_NAMES = {code: name for name, code in _TYPES.items()}
_SIZED = {np.dtype(code).name: code for code in _NAMES}  # "float32" and the like, which other programs write
_LONGEST = 1 << 20  # bytes of a header


def write_vertices(path: Path, columns: Mapping[str, tuple[str, NDArray[Any]]], comments: Sequence[str] = ()) -> None:
    """Write points whose columns are (NumPy type, values) by name, with comments of one line each in ASCII."""
    count = len(next(iter(columns.values()))[1])
    points = np.empty(count, [(name, kind) for name, (kind, _) in columns.items()])
    for name, (_, values) in columns.items():
        points[name] = values
    write_ply(path, points, comments)


def write_ply(path: Path, points: NDArray[Any], comments: Sequence[str] = ()) -> None:
    """Write points [n], a structured array of numbers, with comments of one line each in ASCII."""
    fields = [(name, points.dtype[name]) for name in points.dtype.names or ()]
    header = [
        "ply",
        _FORMAT,
        *(f"comment {comment}" for comment in comments),
        f"element vertex {len(points)}",
        *(f"property {_NAMES[kind.str[1:]]} {name}" for name, kind in fields),
        "end_header",
    ]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(points.astype([(name, kind.newbyteorder("<")) for name, kind in fields]).tobytes())


def read_ply(path: Path) -> tuple[NDArray[Any], list[str]]:
    """Read the points of a PLY file that has them first, and its comments.

    Raises
    ------
    OSError
        If the file cannot be opened.
    LightFieldError
        If it is no PLY, is text or big endian, has lists in its points, or holds fewer points than it claims.
    """
    with path.open("rb") as file:
        start = file.read(_LONGEST)
    end = re.search(rb"\nend_header\r?\n", start)
    if not start.startswith(b"ply") or end is None:
        raise LightFieldError(f"{path} cannot be read as PLY: its header is missing or damaged.")
    lines = start[: end.start()].decode("ascii", "replace").splitlines()[1:]
    comments = [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]
    said = [line.split() for line in lines if not line.startswith(("comment", "obj_info"))]
    if not said or " ".join(said[0]) != _FORMAT:
        raise LightFieldError(f"{path} cannot be read as PLY: it must be binary and little endian, not text.")
    count, dtype = _vertices(path, said[1:])
    if count * dtype.itemsize > path.stat().st_size - end.end():
        raise LightFieldError(f"{path} is damaged: it claims {count} points and ends before them.")
    return np.fromfile(path, dtype, count, offset=end.end()), comments


def _vertices(path: Path, lines: Sequence[list[str]]) -> tuple[int, np.dtype[Any]]:
    """Return the number of points and their type, from the lines of a header after its format."""
    ends = [n for n, words in enumerate(lines) if words[:1] == ["element"]][1:2]
    first, properties = (lines[:1] or [[]])[0], lines[1 : ends[0] if ends else None]
    try:
        element, name, count = first
        if (element, name) != ("element", "vertex") or not count.isdecimal():
            raise ValueError("its first element is no vertex")
        fields = [(name, f"<{_SIZED.get(kind) or _TYPES[kind]}") for word, kind, name in properties if word]
        return int(count), np.dtype(fields)
    except (KeyError, ValueError, TypeError) as error:  # a list has more words, a name may stand twice
        raise LightFieldError(f"{path} cannot be read as PLY: its points must come first and be numbers.") from error
