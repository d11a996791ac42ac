"""What maps can be written as and read from: one table, an entry each, chosen by the suffix of the file."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import map_files, ply
from lfgpu.io.atomic import atomic_write
from lfgpu.io.folders import not_waited_for
from lfgpu.io.git_lfs import check_fetched
from lfgpu.io.pfm import read_pfm, write_pfm_to
from lfgpu.io.results import holds_result, holds_views, read_result, read_views, write_result, write_views

if TYPE_CHECKING:
    from lfgpu.data.views_result import ViewsResult

RESULT_FILE = "result.npz"
"""What `lfgpu depth` calls the file that holds everything."""


@dataclass(frozen=True)
class Writer:
    """One entry of the table."""

    suffixes: tuple[str, ...]
    """Lower case, with the dot; the first is the usual one."""
    description: str
    """One line for lists and help, without a full stop."""
    write: Callable[[DisparityMap, Path, NDArray[Any] | None], None] | None
    """Writes a map, coloured by an image where the format has colours, to a path; None if it is only read."""
    read: Callable[[Path], DisparityMap]
    """Reads it back, with all that the file says about it."""


def _write_pfm(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    write_pfm_to(path, np.asarray(values.disparity, np.float32))


def _read_pfm(path: Path) -> DisparityMap:
    return DisparityMap(read_pfm(path), name=path.name)


WRITERS: tuple[Writer, ...] = (
    Writer((".pfm",), "float32, as the HCI benchmark takes it; holds no metadata", _write_pfm, _read_pfm),
    Writer(
        (".npz",),
        "NumPy: a result with everything, maps of all views, or a map with its confidence",
        map_files.write_npz,
        map_files.read_numpy,
    ),
    Writer((".png",), "16 bits, with scale and offset as its text", map_files.write_png, map_files.read_png),
    Writer((".tif", ".tiff"), "float32, metadata as its description", map_files.write_tiff, map_files.read_tiff),
    Writer((".exr",), "OpenEXR: float32 disparity, confidence and depth (Z)", map_files.write_exr, map_files.read_exr),
    Writer((".ply",), "point cloud, coloured, in metres if the geometry is known", ply.write_ply, ply.read_ply),
    Writer((".npy",), "NumPy: the values", None, map_files.read_numpy),
)


def save(
    result: DepthResult | ViewsResult | DisparityMap,
    path: str | os.PathLike[str],
    *,
    image: ArrayLike | None = None,
) -> None:
    """Write a result or a map in the format that the suffix of the file names; whole or not at all.

    Parameters
    ----------
    result
        What `estimate_depth` or `estimate_all_views` returned, or a map by itself (`ViewsResult.map(index)`).
    path
        .npz: everything. .pfm, .png (16 bits), .tif, .exr: the disparity map. .ply: the points in space. All but .pfm
        hold unit, sign, view, geometry, name and version; NaN is not known, in .png that is 0, in .ply it has no point.
        In .npz, .exr and .ply the confidence comes along.
    image
        [y, x, c]: the view, for the colours of a .ply; others leave it out. Default: no colours.

    Raises
    ------
    LightFieldError
        If the suffix is none of these, the map is not [y, x], maps of all views shall go into a file for one, a library
        is missing, or the file cannot be written.
    """
    path = Path(path)
    writer = writer_of(path)
    pixels = None if image is None else np.asarray(image)
    if isinstance(result, DepthResult):
        if path.suffix.lower() == ".npz":
            write_result(result, path)
            return
        result = result.map
    if not isinstance(result, DisparityMap):
        if path.suffix.lower() != ".npz":
            raise LightFieldError(
                f"{path} cannot be written: it is for one map, and there are those of {len(result.disparities)} views; "
                "choose one with .map(index), or the suffix .npz."
            )
        write_views(result, path)
        return
    shape = np.shape(result.disparity)
    if len(shape) != 2 or 0 in shape:
        raise LightFieldError(f"{path} cannot be written: a map must be [y, x], found shape {shape}.")
    assert writer.write is not None
    with atomic_write(path) as temporary:
        writer.write(result, temporary, pixels)


def writer_of(path: str | os.PathLike[str]) -> Writer:
    """The entry of the table that writes a file; LightFieldError if there is none or what it needs is missing."""
    path = Path(path)
    for writer in WRITERS:
        if writer.write is not None and path.suffix.lower() in writer.suffixes:
            if path.suffix.lower() == ".exr":
                map_files.open_exr(path)
            return writer
    known = ", ".join(writer.suffixes[0] for writer in WRITERS if writer.write is not None)
    raise LightFieldError(f"{path} cannot be written: a map is stored as {known}; choose one of these suffixes.")


def load(path: str | os.PathLike[str]) -> DepthResult | ViewsResult | DisparityMap:
    """Read back what `save` or `lfgpu depth` wrote.

    Parameters
    ----------
    path
        A file that `save` wrote, another map, or a folder that `lfgpu depth` wrote, whose result.npz is taken.

    Returns
    -------
    `DepthResult` or `ViewsResult` from an .npz that holds one, else `DisparityMap`, with what the file says about it.
    The values are those that were written, of a .png within half a step of its scale.

    Raises
    ------
    LightFieldError
        If the file is missing, damaged, of another kind, or not a map.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / RESULT_FILE).exists():
            raise LightFieldError(f"{path} holds no {RESULT_FILE}; give a folder that lfgpu depth wrote, or a file.")
        path = path / RESULT_FILE
    check_fetched(path)
    not_waited_for(path)
    if path.suffix.lower() == ".npz":
        if holds_views(path):
            return read_views(path)
        if holds_result(path):
            return read_result(path)
    return load_map(path)


def load_map(path: Path) -> DisparityMap:
    """The map in a file, whatever else it holds; LightFieldError if there is none."""
    check_fetched(path)
    not_waited_for(path)
    for writer in WRITERS:
        if path.suffix.lower() in writer.suffixes:
            return map_files.check_map(path, writer.read)
    known = ", ".join(writer.suffixes[0] for writer in WRITERS)
    raise LightFieldError(f"{path} is not a kind of map that can be read; known are {known}.")
