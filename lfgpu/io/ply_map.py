"""Point clouds as binary PLY, each point with the pixel and the disparity that it comes from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.points import point_cloud
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import DAMAGE, KEY, map_about, map_of, parse_about
from lfgpu.io.limits import check_claim
from lfgpu.io.ply import read_ply, write_vertices

_MARK = f"{KEY} "  # what the comment begins with that holds the metadata
_RELIEF_PERCENTILES = (1, 99)
_DEEPEST = 0.5  # of the longer side of the image


def write(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
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


def read(path: Path) -> DisparityMap:
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
