"""Plain PNG files decoded by imagecodecs where it is installed, in about half of Pillow's time."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_CHANNELS = {"L": 1, "RGB": 3}
_NOT_PLAIN = ("transparency", "interlace")


def fast_pixels(path: Path, image: Image.Image) -> NDArray[np.uint8] | None:
    """The pixels of a PNG that Pillow has opened; None where Pillow has to decode it.

    Parameters
    ----------
    path
        The file.
    image
        What its header says.

    Returns
    -------
    NDArray or None
        [y, x] or [y, x, 3], uint8, the same values as Pillow's. None for anything but grey and RGB of 8 bits, for
        damaged files, which Pillow describes, and without imagecodecs.
    """
    codecs = _imagecodecs()
    if codecs is None or image.format != "PNG" or not _is_plain(image):
        return None
    try:
        pixels: NDArray[Any] = codecs.spng_decode(path.read_bytes())
    except Exception:  # what is wrong with a file is said in the words of Pillow
        return None
    size = image.height, image.width
    wanted = size if image.mode == "L" else (*size, _CHANNELS[image.mode])
    return pixels if pixels.dtype == np.uint8 and pixels.shape == wanted else None


def _is_plain(image: Image.Image) -> bool:
    raw = image.tile[0][3] if getattr(image, "tile", None) else ""  # type: ignore[attr-defined]
    return image.mode in _CHANNELS and raw == image.mode and not any(name in image.info for name in _NOT_PLAIN)


@cache
def _imagecodecs() -> ModuleType | None:
    try:
        import imagecodecs
    except ImportError:  # it is not there, or was built for another NumPy
        return None
    return imagecodecs if imagecodecs.SPNG.available else None
