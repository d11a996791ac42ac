"""PLY files of points, and maps as point clouds in them.

A file has one element `vertex`, binary and little endian, each of its properties a number; each point of a map has the
pixel and the disparity that it comes from.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.points import point_cloud
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import DAMAGE, KEY, map_about, map_of, parse_about
from lfgpu.io.damage import check_claim

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
    """Read the points of a binary, little endian PLY file that has them first, and its comments."""
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


_MARK = f"{KEY} "  # what the comment begins with that holds the metadata
_RELIEF_PERCENTILES = (1, 99)
_DEEPEST = 0.5  # of the longer side of the image


def write_map(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write x, y, z, colours if there is an image, confidence if known, disparity, column and row of each point."""
    cloud = point_cloud(values, image=image)
    points, relief = cloud.points, 1.0
    if not cloud.metric:
        relief = _relief(points[:, 2], values.disparity.shape)
        points = points * np.array([1, 1, relief], np.float32)
    columns: dict[str, tuple[str, NDArray[Any]]] = {name: ("f4", points[:, axis]) for axis, name in enumerate("xyz")}
    if cloud.colors is not None:
        columns |= {name: ("u1", cloud.colors[:, n]) for n, name in enumerate(("red", "green", "blue"))}
    if cloud.confidence is not None:
        columns["confidence"] = ("f4", cloud.confidence)
    column, row = cloud.pixels.T
    columns |= {"disparity": ("<f4", values.disparity[row, column]), "column": ("<i4", column), "row": ("<i4", row)}
    unit = (
        "metres"
        if cloud.metric
        else f"pixels; z is -{relief:g} times the disparity in pixels per view step, as no geometry is known"
    )
    comments = [
        f"x to the right, y down, z away from the camera, in {unit}",
        _MARK
        + map_about(
            values,
            height=values.disparity.shape[0],
            width=values.disparity.shape[1],
            z_per_disparity=None if cloud.metric else -relief,
            invalid="pixels without a point are not known or at infinity",
        ),
    ]
    write_vertices(path, columns, comments)


def _relief(z: NDArray[np.float32], size: tuple[int, ...]) -> float:
    """Return the factor of disparities with which a cloud without geometry is no flat sheet: a power of two, >= 1.

    The relief, without the farthest hundredths, is then a quarter to a half as deep as the image is large.
    """
    low, high = np.percentile(z, _RELIEF_PERCENTILES)
    if high <= low:
        return 1.0
    return float(max(1.0, 2.0 ** np.floor(np.log2(_DEEPEST * max(size) / (high - low)))))


def read_map(path: Path) -> DisparityMap:
    """Read the map that a cloud of ours was made of, NaN where it has no point."""
    vertices, comments = read_ply(path)
    texts = [comment.removeprefix(_MARK) for comment in comments if comment.startswith(_MARK)]
    if len(texts) != 1:
        raise LightFieldError(
            f"{path} is not a point cloud of lfgpu: it does not say which pixels its points belong to."
        )
    about = parse_about(path, texts[0])
    try:
        height, width = int(about["height"]), int(about["width"])
        if min(height, width) < 1 or min(vertices[name].min(initial=0) for name in ("row", "column")) < 0:
            raise ValueError("no pixels of a map")
        check_claim(path, (2, height, width), np.float32)
        at = vertices["row"], vertices["column"]
        disparity = np.full((height, width), np.nan, np.float32)
        disparity[at] = vertices["disparity"]
        confidence = None
        if "confidence" in (vertices.dtype.names or ()):
            confidence = np.zeros((height, width), np.float32)
            confidence[at] = vertices["confidence"]
    except LightFieldError:
        raise
    except DAMAGE as error:
        raise LightFieldError(
            f"{path} is a damaged point cloud of lfgpu: its points are not those of a map."
        ) from error
    return map_of(path, about, disparity, confidence)
