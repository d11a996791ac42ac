"""PLY files of points, and maps as point clouds in them.

A file has one element `vertex`, binary and little endian, each of its properties a number; each point of a map has the
pixel and the disparity that it comes from.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import DisparityMap, point_cloud
from lfgpu.io.about import KEY, map_about

_NAMES = {"u1": "uchar", "i4": "int", "f4": "float"}
_RELIEF_PERCENTILES = (1, 99)
_DEEPEST = 0.5  # of the longer side of the image


def write_vertices(path: Path, columns: Mapping[str, tuple[str, NDArray[Any]]], comments: Sequence[str] = ()) -> None:
    """Write points whose columns are (u1, i4 or f4, values) by name, with comments of one line each in ASCII."""
    count = len(next(iter(columns.values()))[1])
    points = np.empty(count, [(name, f"<{kind}") for name, (kind, _) in columns.items()])
    for name, (_, values) in columns.items():
        points[name] = values
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {count}",
        *(f"property {_NAMES[kind]} {name}" for name, (kind, _) in columns.items()),
        "end_header",
    ]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(points.tobytes())


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
    columns |= {"disparity": ("f4", values.disparity[row, column]), "column": ("i4", column), "row": ("i4", row)}
    unit = (
        "metres"
        if cloud.metric
        else f"pixels; z is -{relief:g} times the disparity in pixels per view step, as no geometry is known"
    )
    comments = [
        f"x to the right, y down, z away from the camera, in {unit}",
        f"{KEY} {map_about(values, invalid='pixels without a point are not known or at infinity')}",
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
