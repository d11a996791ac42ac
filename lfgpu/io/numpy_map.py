"""Maps as NumPy files: .npz, with metadata beside the arrays, and .npy, of the values only."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float32Array
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.folders import head
from lfgpu.io.numpy_file import MAGIC, header, load_arrays
from lfgpu.io.results import has_array, holds_views, store

NPZ_KEY = "lfgpu_map"
"""The array of an .npz that holds the metadata of a map by itself."""

_AXES = 2  # of a map
_MAP_KEY = "disparity"  # the array that is taken for the map


def recognise_npz(path: Path) -> bool:
    """Tell whether an archive holds a map or those of all views, going by the names of its arrays."""
    return has_array(path, _MAP_KEY) or holds_views(path)


def write_npz(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write `disparity`, `confidence`, `uncertainty` and `depth` as far as known, and the metadata as a text."""
    store(path, values.known_maps | {NPZ_KEY: np.array(map_about(values, invalid=UNKNOWN_IS_NAN))})


def read_npz(path: Path) -> DisparityMap:
    """Read the array `disparity`, whatever else there is; confidence and metadata if they are of a map by itself."""
    arrays = load_arrays(path, (_MAP_KEY, NPZ_KEY, "confidence", "uncertainty"), of_maps=True)
    disparity = _as_map(path, arrays[_MAP_KEY])
    if NPZ_KEY not in arrays:
        return DisparityMap(disparity, name=path.name)
    about = parse_about(path, str(arrays[NPZ_KEY]))
    return map_of(path, about, disparity, arrays.get("confidence"), arrays.get("uncertainty"))


def recognise_npy(path: Path) -> bool:
    """Tell by its header whether an array is [y, x]; False for one of views."""
    try:
        with path.open("rb") as file:
            return head(path, len(MAGIC)) == MAGIC and len(header(path, file)[0]) == _AXES
    except Exception:  # damaged, which whoever reads it will say
        return False


def read_npy(path: Path) -> DisparityMap:
    """Read the array of an .npy as a map."""
    return DisparityMap(_as_map(path, load_arrays(path, ("disparity",))["disparity"]), name=path.name)


def _as_map(path: Path, values: NDArray[Any]) -> Float32Array:
    if values.ndim != _AXES or values.dtype.kind not in "fiu" or 0 in values.shape:
        raise LightFieldError(f"{path} must hold numbers [y, x]; found {values.dtype} of shape {values.shape}.")
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
