"""Maps (disparity, depth) and masks from files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.images import read_image
from lfgpu.io.numpy_arrays import load_arrays
from lfgpu.io.pfm import read_pfm

MAP_KEY = "disparity"
"""The array of an .npz file that is taken for the map."""


def read_map(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a map: one value per pixel.

    Parameters
    ----------
    path
        .pfm, .npy, .npz (its array "disparity"), .tif or .tiff, all with one channel; the suffix in any case.

    Returns
    -------
    float32 [y, x], top row first, in the unit of the file; NaN and infinities are kept (in a TIFF they are refused).

    Raises
    ------
    LightFieldError
        If the file is missing, damaged, of another kind, or not a map.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".pfm":
            return read_pfm(path)
        if suffix in (".npy", ".npz"):
            return _read_numpy(path)
    except OSError as error:
        raise LightFieldError(f"{path} cannot be opened: {error.strerror or error}.") from error
    if suffix in (".tif", ".tiff"):
        image, _ = read_image(path)
        if image.shape[2] != 1:
            raise LightFieldError(f"{path} is a colour image; a map has one value per pixel.")
        return image[..., 0].astype(np.float32)
    raise LightFieldError(f"{path} is not a kind of map that can be read; known are .pfm, .npy, .npz and .tif.")


def read_mask(path: str | os.PathLike[str]) -> NDArray[np.bool_]:
    """Read an image as a mask: bool [y, x], True where any of its colours is not zero.

    Raises
    ------
    LightFieldError
        If the file cannot be read as an image.
    """
    image, _ = read_image(path)
    return np.asarray((image != 0).any(axis=2))


def check_size(path: Path, array: NDArray[Any], size: tuple[int, int]) -> None:
    """LightFieldError unless what a file holds has the (height, width) of the views."""
    if array.shape != size:
        raise LightFieldError(
            f"{path} has {array.shape[1]} x {array.shape[0]} pixels, but the views have {size[1]} x {size[0]}; "
            "remove it or put the right one there."
        )


def _read_numpy(path: Path) -> NDArray[np.float32]:
    loaded = load_arrays(path, (MAP_KEY,))[MAP_KEY]
    if loaded.ndim != 2 or loaded.dtype.kind not in "fiu" or 0 in loaded.shape:
        raise LightFieldError(f"{path} must hold numbers [y, x]; found {loaded.dtype} of shape {loaded.shape}.")
    with np.errstate(over="ignore"):
        return np.asarray(loaded, np.float32)
