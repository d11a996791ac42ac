"""Maps as .npy: the values, and nothing that says what they mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float32Array
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.folders import head
from lfgpu.io.numpy_arrays import MAGIC, header, load_arrays

_AXES = 2


def recognise(path: Path) -> bool:
    """Whether the array is [y, x], going by its header; False for one of views."""
    try:
        with path.open("rb") as file:
            return head(path, len(MAGIC)) == MAGIC and len(header(path, file)[0]) == _AXES
    except Exception:  # damaged, which whoever reads it will say
        return False


def read(path: Path) -> DisparityMap:
    """The array as a map."""
    return DisparityMap(as_map(path, load_arrays(path, ("disparity",))["disparity"]), name=path.name)


def as_map(path: Path, values: NDArray[Any]) -> Float32Array:
    """An array as float32 [y, x]; LightFieldError that names the file if it is no map."""
    if values.ndim != _AXES or values.dtype.kind not in "fiu" or 0 in values.shape:
        raise LightFieldError(f"{path} must hold numbers [y, x]; found {values.dtype} of shape {values.shape}.")
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
