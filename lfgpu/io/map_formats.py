"""The formats of maps: one table, an entry each, chosen by the suffix of the file.

`save`, `load` and `read_map`, the viewer, `lfgpu convert`, `lfgpu eval` and the option `--save` know formats by this
table only. A new format is a function that reads, one that writes, and a row here.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data import DepthResult, DisparityMap, ViewsResult
from lfgpu.data.light_field_checks import named
from lfgpu.data.result import check_result
from lfgpu.errors import LightFieldError
from lfgpu.io import exr, image_maps, pfm, ply, results
from lfgpu.io.atomic import atomic_write
from lfgpu.io.damage import check_fetched, how_to_install, read_as
from lfgpu.io.folders import not_waited_for

RESULT_FILE = "result.npz"
"""Everything."""
DISPARITY_FILE = "disparity.pfm"
"""The disparity map by itself."""
DEPTH_FILE = "depth.pfm"
"""The metric depth by itself."""
VIEWS_FILE = "disparities.npz"
"""The maps of all views."""
REPORT_FILE = "report.html"
"""The page about a result, about a batch or about a comparison."""

_NOT_DISPARITY = re.compile(r"(?<![^\W_])(depth|confidence)(?![^\W_])", re.IGNORECASE)  # as a word of a name

Whole: TypeAlias = DepthResult | ViewsResult
OneMap: TypeAlias = DepthResult | DisparityMap


@dataclass(frozen=True)
class MapFormat:
    """One entry of the table."""

    suffixes: tuple[str, ...]  # lower case, with the dot; the first is the usual one
    description: str  # one line for lists and help, without a full stop
    read: Callable[[Path], DisparityMap] | None = None
    """Reads a map, with all that the file says about it, or raises OSError or LightFieldError; None if it is only
    written."""
    write: Callable[[DisparityMap, Path, NDArray[Any] | None], None] | None = None
    """Writes a map, coloured by an image where the format has colours, to a path; None if it is only read."""
    read_whole: Callable[[Path], Whole | None] | None = None
    """Reads a result with everything, None from a file of a map only; None if the format holds maps only."""
    write_whole: Callable[[Whole, Path], None] | None = None
    """Writes such a result to a path; None if the format holds maps only."""
    recognise: Callable[[Path], bool] | None = None
    """Tells maps from light fields with the same suffix; None if the suffix says it."""
    library: str | None = None  # the library that it needs besides those of the package
    extra: str | None = None  # the extra of the package that brings it

    @property
    def is_available(self) -> bool:
        """True if the library that it needs is installed."""
        return self.library is None or importlib.util.find_spec(self.library) is not None


MAP_FORMATS: tuple[MapFormat, ...] = (
    MapFormat(
        (".pfm",), "float32, as the HCI benchmark takes it; holds no metadata", read=pfm.read_map, write=pfm.write_map
    ),
    MapFormat(
        (".npz",),
        "NumPy: a result with everything, maps of all views, or a map with its confidence",
        read=results.read_npz,
        write=results.write_npz,
        read_whole=results.read_whole,
        write_whole=results.write_whole,
        recognise=results.recognise_npz,
    ),
    MapFormat(
        (".png",),
        "16 bits, with scale and offset as its text",
        read=image_maps.read_png,
        write=image_maps.write_png,
        recognise=image_maps.recognise_png,
    ),
    MapFormat(
        (".tif", ".tiff"),
        "float32, metadata as its description",
        read=image_maps.read_tiff,
        write=image_maps.write_tiff,
        recognise=image_maps.recognise_tiff,
    ),
    MapFormat(
        (".exr",),
        "OpenEXR: float32 disparity, confidence, uncertainty and depth (Z)",
        read=exr.read_map,
        write=exr.write_map,
        library="OpenEXR",
        extra="exr",
    ),
    MapFormat(
        (".ply",),
        "point cloud, coloured, in metres if the geometry is known",
        write=ply.write_map,
    ),
    MapFormat((".npy",), "NumPy: the values", read=results.read_npy, recognise=results.recognise_npy),
)


def save(
    result: DepthResult | ViewsResult | DisparityMap,
    path: str | os.PathLike[str],
    *,
    image: ArrayLike | None = None,
) -> None:
    """Write a result or a map to a file, in the format that the suffix names. The file is written whole or not at all.

    Parameters
    ----------
    result
        What `estimate_depth` or `estimate_all_views` returned, or a map by itself (`ViewsResult.map(index)`).
    path
        .npz holds everything; .pfm, .png (16 bits), .tif and .exr hold the disparity map; .ply holds points in space.
        All but .pfm also say unit, sign, view, geometry, name and version. Unknown pixels are NaN, in .png 0; in .ply
        they have no point. .npz, .exr and .ply hold the confidence, too.
    image
        The view [y, x, c] that gives the points of a .ply their colours; other formats ignore it. Default None: no
        colours.

    Raises
    ------
    LightFieldError
        If the suffix is none of these, the map is not [y, x], the maps of all views are given for a format that holds
        one, a library is missing, or the file cannot be written.

    Examples
    --------
    >>> lfgpu.save(result, "cloud.ply", image=lf.image(lf.reference_index))
    >>> lfgpu.save(result, "result.npz")
    >>> lfgpu.load("result.npz").name
    'boxes'
    """
    check_result(result, ViewsResult, DisparityMap)
    path = named(path)
    chosen = writable_format(path)
    assert chosen.write is not None  # that is what writable means
    if not isinstance(result, DisparityMap) and chosen.write_whole is not None:
        with atomic_write(path) as temporary:
            chosen.write_whole(result, temporary)
        return
    values = result.map if isinstance(result, DepthResult) else result
    if not isinstance(values, DisparityMap):
        whole = _suffixes(entry for entry in MAP_FORMATS if entry.write_whole is not None)
        raise LightFieldError(
            f"{path} cannot be written: it is for one map, and there are those of {len(values.disparities)} views; "
            f"choose one with .map(index), or the suffix {whole}."
        )
    shape = np.shape(values.disparity)
    if len(shape) != 2 or 0 in shape:
        raise LightFieldError(f"{path} cannot be written: a map must be [y, x], found shape {shape}.")
    with atomic_write(path) as temporary:
        chosen.write(values, temporary, None if image is None else np.asarray(image))


def load(path: str | os.PathLike[str]) -> DepthResult | ViewsResult | DisparityMap:
    """Read back what `save` or `lfgpu depth` wrote.

    Parameters
    ----------
    path
        A file that `save` wrote, another map, or a folder that `lfgpu depth` wrote: its result.npz, or its
        disparity.pfm if there is no result.npz.

    Returns
    -------
    `DepthResult` or `ViewsResult` from an .npz that holds one, else `DisparityMap`, with what the file says about it.
    The values are those that were written; of a .png, within half a step of its scale.

    Raises
    ------
    LightFieldError
        If the file is missing, damaged, of another kind, or not a map.

    Examples
    --------
    >>> result.save("result.npz")
    >>> lfgpu.load("result.npz").confidence.shape
    (64, 80)
    """
    path = named(path)
    if path.is_dir():
        file = result_in(path)
        if file is None:
            raise LightFieldError(
                f"{path} holds neither {RESULT_FILE} nor {DISPARITY_FILE}; give a folder that lfgpu depth wrote, or a "
                "file."
            )
        path = file
    chosen = readable_format(path)
    if path.suffix.lower() == ".pfm" and (other := _NOT_DISPARITY.search(path.stem)):
        raise LightFieldError(
            f"{path} holds {other[0].lower()} by its name, and a map has to be disparity; give {DISPARITY_FILE} or the "
            "folder of the result, or rename the file if it does hold disparity."
        )
    whole = None if chosen.read_whole is None else chosen.read_whole(path)
    return whole if whole is not None else _map(path, chosen)


def one_map(found: DepthResult | ViewsResult | DisparityMap, at: Sequence[float] | None = None) -> OneMap:
    """Return the map of one view of what `load` returned: of maps of all views that of the view at (u, v).

    Default None: that of the reference view. LightFieldError if there is no view at (u, v).
    """
    if not isinstance(found, ViewsResult):
        return found
    return found.map(found.keys[0] if at is None else found.index_of(float(at[1]), float(at[0])))


def read_map(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a map of any of `MAP_FORMATS`, float32 [y, x], top row first, in the unit of the file."""
    path = named(path)
    return _map(path, readable_format(path)).disparity


def holds_map(path: str | os.PathLike[str]) -> bool:
    """Tell whether a path is there and is what `load` reads, by its suffix, and by its contents if need be."""
    path = named(path)
    if path.is_dir():
        return result_in(path) is not None
    chosen = _named_as(path)
    return (
        chosen is not None
        and chosen.read is not None
        and path.exists()
        and (chosen.recognise is None or chosen.recognise(path))
    )


def result_in(folder: Path) -> Path | None:
    """Find the file of a folder that `lfgpu depth` wrote which tells most; None if it has none."""
    return next((folder / name for name in (RESULT_FILE, DISPARITY_FILE) if (folder / name).is_file()), None)


def writable_format(path: str | os.PathLike[str]) -> MapFormat:
    """Return the entry that writes a file; LightFieldError if there is none, or its library is missing."""
    path = named(path)
    chosen = _named_as(path)
    if chosen is None or chosen.write is None:
        known = _suffixes(entry for entry in MAP_FORMATS if entry.write is not None)
        raise LightFieldError(f"{path} cannot be written: a map is stored as {known}; choose one of these suffixes.")
    return _usable(path, chosen)


def readable_format(path: Path) -> MapFormat:
    """Return the entry that reads a file; LightFieldError if there is none, or its library is missing."""
    check_fetched(path)
    not_waited_for(path)
    chosen = _named_as(path)
    if not path.suffix and not path.exists():
        raise LightFieldError(f"{path} does not exist; give a map, or a folder that lfgpu depth wrote.")
    if chosen is None or chosen.read is None:
        known = _suffixes(entry for entry in MAP_FORMATS if entry.read is not None)
        raise LightFieldError(f"{path} is not a kind of map that can be read; known are {known}.")
    return _usable(path, chosen)


def _named_as(path: Path) -> MapFormat | None:
    return next((entry for entry in MAP_FORMATS if path.suffix.lower() in entry.suffixes), None)


def _usable(path: Path, chosen: MapFormat) -> MapFormat:
    if not chosen.is_available:
        raise LightFieldError(
            f"{path} is a file of maps that needs {chosen.library}; {how_to_install(str(chosen.extra))}."
        )
    return chosen


def _map(path: Path, chosen: MapFormat) -> DisparityMap:
    """Read the map in a file, with its confidence of the same size; OSErrors become sentences."""
    assert chosen.read is not None  # that is what readable means
    with read_as(path):
        values = chosen.read(path)
    for name, map_ in (("confidence", values.confidence), ("uncertainty", values.uncertainty)):
        if map_ is not None and map_.shape != values.disparity.shape:
            raise LightFieldError(f"{path} is damaged: its {name} has another size than its disparity.")
    return values


def _suffixes(entries: Iterable[MapFormat]) -> str:
    return ", ".join(entry.suffixes[0] for entry in entries)
