"""What readers of light fields need of maps and masks beside the views."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.images import read_image
from lfgpu.io.map_formats import read_map

__all__ = ["check_size", "read_map", "read_mask"]


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
