"""Maps as images: PNG of 16 bits and TIFF of float32, each with a text that says what its values mean."""

from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.PngImagePlugin import PngInfo

from lfgpu.data import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow, tiff_stack
from lfgpu.io.about import DAMAGE, KEY, UNKNOWN_IS_NAN, map_about, map_of, parse_about
from lfgpu.io.images import read_image
from lfgpu.io.tiff_pages import pages

_UNKNOWN, _LEVELS = 0, 65534  # what pixels that are not known have, and the steps between the least and the most


def recognise_png(path: Path) -> bool:
    """Tell whether a PNG says that it is a map; False for pictures."""
    try:
        with pillow.opened(path) as image:
            return KEY in getattr(image, "text", {})
    except Exception:  # Pillow raises whatever comes to it when a file is damaged; who reads it says what it is
        return False


def write_png(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write 16-bit grey: disparity = offset + scale * value, 0 where it is unknown; the error is at most scale / 2."""
    known = np.isfinite(values.disparity)
    low, high = (float(f(values.disparity[known])) if known.any() else 0.0 for f in (np.min, np.max))
    scale = (high - low) / _LEVELS or 1.0
    stored = np.zeros(known.shape, np.uint16)
    stored[known] = 1 + np.rint((values.disparity[known].astype(np.float64) - low) / scale)
    about = map_about(
        values, scale=scale, offset=low - scale, formula="disparity = offset + scale * value", invalid="0 is not known"
    )
    text = PngInfo()
    text.add_text(KEY, about)
    Image.fromarray(stored).save(path, format="PNG", pnginfo=text)


def read_png(path: Path) -> DisparityMap:
    """Read what `write_png` wrote; another PNG is refused, as it does not say what its values mean."""
    stored, _ = read_image(path)
    with pillow.opened(path) as image:
        text = getattr(image, "text", {}).get(KEY)
    if text is None or stored.dtype != np.uint16 or stored.shape[2] != 1:
        raise LightFieldError(
            f"{path} is not a kind of map that can be read: a PNG has to have 16 bits, one channel and a text "
            f"{KEY!r} that says what its values mean; give a .pfm, .npy, .npz, .tif or .exr."
        )
    about = parse_about(path, text)
    try:
        disparity = float(about["offset"]) + float(about["scale"]) * stored[..., 0].astype(np.float64)
    except DAMAGE as error:
        raise LightFieldError(f"{path} is a damaged map of lfgpu: its metadata are incomplete.") from error
    return map_of(path, about, np.where(stored[..., 0] == _UNKNOWN, np.nan, disparity).astype(np.float32), None)


_DESCRIPTION_TAG = 270


def recognise_tiff(path: Path) -> bool:
    """Tell whether a TIFF has one page; one of several pages is a light field."""
    return path.is_file() and tiff_stack.recognise(path) is None


def write_tiff(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write float32 values, with the metadata as the description of the image."""
    tags = {_DESCRIPTION_TAG: map_about(values, invalid=UNKNOWN_IS_NAN)}
    Image.fromarray(np.asarray(values.disparity, np.float32)).save(path, format="TIFF", tiffinfo=tags)


def read_tiff(path: Path) -> DisparityMap:
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
