"""Maps as TIFF: float32, with the metadata as the description of the image."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow, tiff_stack
from lfgpu.io.about import KEY, UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.images import read_image
from lfgpu.io.tiff_pages import pages

_DESCRIPTION_TAG = 270


def recognise(path: Path) -> bool:
    """Tell whether a TIFF has one page; one of several pages is a light field."""
    return path.is_file() and tiff_stack.recognise(path) is None


def write(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write float32 values, with the metadata as the description of the image."""
    tags = {_DESCRIPTION_TAG: map_about(values, invalid=UNKNOWN_IS_NAN)}
    Image.fromarray(np.asarray(values.disparity, np.float32)).save(path, format="TIFF", tiffinfo=tags)


def read(path: Path) -> DisparityMap:
    """Read a TIFF of one channel; of others than ours nothing but the values is known."""
    if path.is_file() and len(list(islice(pages(path), 2))) > 1:
        raise LightFieldError(f"{path} has several pages, as a light field has; a map has one.")
    stored, _ = read_image(path, finite=False)
    if stored.shape[2] != 1:
        raise LightFieldError(f"{path} is a colour image; a map has one value per pixel.")
    disparity = stored[..., 0].astype(np.float32)
    text = ""
    with suppress(UnidentifiedImageError), pillow.opened(path) as image:  # kinds that Pillow does not know are not ours
        text = str(getattr(image, "tag_v2", {}).get(_DESCRIPTION_TAG, ""))
    if f'"{KEY}"' not in text:
        return DisparityMap(disparity, name=path.name)
    return map_of(path, parse_about(path, text), disparity, None)
