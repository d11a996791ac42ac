"""Maps (disparity, depth) and masks from files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.images import read_image


def read_map(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a map: one value per pixel.

    Parameters
    ----------
    path
        .pfm, .npy, .npz (its array "disparity"), .tif or .tiff, .exr (its channel "disparity"), all with one channel;
        .png and .ply that `lfgpu.save` wrote; the suffix in any case. `lfgpu.load` also tells what the file says of it.

    Returns
    -------
    float32 [y, x], top row first, in the unit of the file; NaN and infinities are kept.

    Raises
    ------
    LightFieldError
        If the file is missing, damaged, of another kind, or not a map.
    """
    from lfgpu.io.writers import load_map  # which needs results, which need this

    return load_map(Path(path)).disparity


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
