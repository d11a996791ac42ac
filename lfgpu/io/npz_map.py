"""Maps as .npz: a map with its confidence and metadata, a whole result, or the maps of all views."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.data.views_result import ViewsResult
from lfgpu.io.about import UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.npy_map import as_map
from lfgpu.io.numpy_arrays import load_arrays
from lfgpu.io.results import (
    arrays_of_result,
    arrays_of_views,
    has_array,
    holds_result,
    holds_views,
    read_result,
    read_views,
)

NPZ_KEY = "lfgpu_map"
"""The array of an .npz that holds the metadata of a map by itself."""

_MAP_KEY = "disparity"  # the array that is taken for the map


def recognise(path: Path) -> bool:
    """Whether an archive holds a map or those of all views, going by the names of its arrays."""
    return has_array(path, _MAP_KEY) or holds_views(path)


def write(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """`disparity`, `confidence`, `uncertainty` and `depth` as far as they are known, and the metadata as a text."""
    arrays = {
        "disparity": values.disparity,
        "confidence": values.confidence,
        "uncertainty": values.uncertainty,
        "depth": values.depth,
    }
    kept: dict[str, NDArray[Any]] = {name: array for name, array in arrays.items() if array is not None}
    _store(path, kept | {NPZ_KEY: np.array(map_about(values, invalid=UNKNOWN_IS_NAN))})


def read(path: Path) -> DisparityMap:
    """The array `disparity`, whatever else there is; confidence and metadata if they are of a map by itself."""
    arrays = load_arrays(path, (_MAP_KEY, NPZ_KEY, "confidence", "uncertainty"), of_maps=True)
    disparity = as_map(path, arrays[_MAP_KEY])
    if NPZ_KEY not in arrays:
        return DisparityMap(disparity, name=path.name)
    about = parse_about(path, str(arrays[NPZ_KEY]))
    return map_of(path, about, disparity, arrays.get("confidence"), arrays.get("uncertainty"))


def write_whole(result: DepthResult | ViewsResult, path: Path) -> None:
    """A result with everything, or the maps of all views."""
    _store(path, arrays_of_result(result) if isinstance(result, DepthResult) else arrays_of_views(result))


def read_whole(path: Path) -> DepthResult | ViewsResult | None:
    """What `write_whole` wrote; None for other archives."""
    if holds_views(path):
        return read_views(path)
    return read_result(path) if holds_result(path) else None


def _store(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)  # to pack them would save a sixth, in 60 times the time
