"""Plain PNG files decoded by kornia_rs or imagecodecs where they are installed, faster than by Pillow.

kornia_rs takes about 0.4 of Pillow's time and imagecodecs 0.65, but kornia_rs lets no other thread of the interpreter
run meanwhile. So a process that may use one thread takes kornia_rs, as one of many workers does, and others take
imagecodecs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lfgpu.threads import get_threads

_Decoder: TypeAlias = Callable[[bytes, Image.Image], NDArray[Any]]

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
        damaged files, which Pillow describes, and without a decoder.
    """
    alone, beside = _kornia(), _imagecodecs()
    decode = (alone or beside) if get_threads() == 1 else (beside or alone)
    if decode is None or image.format != "PNG" or not _is_plain(image):
        return None
    try:
        pixels = decode(path.read_bytes(), image)
    except Exception:  # what is wrong with a file is said in the words of Pillow
        return None
    size = image.height, image.width
    wanted = size if image.mode == "L" else (*size, _CHANNELS[image.mode])
    return pixels if pixels.dtype == np.uint8 and pixels.shape == wanted else None


def _is_plain(image: Image.Image) -> bool:
    raw = image.tile[0][3] if getattr(image, "tile", None) else ""  # type: ignore[attr-defined]
    return image.mode in _CHANNELS and raw == image.mode and not any(name in image.info for name in _NOT_PLAIN)


@cache
def _kornia() -> _Decoder | None:
    try:
        from kornia_rs.io import decode_image_png_u8
    except ImportError:
        return None

    def decode(data: bytes, image: Image.Image) -> NDArray[Any]:
        size = image.height, image.width
        if image.mode == "L":
            return np.asarray(decode_image_png_u8(data, size, "mono"))[..., 0]
        return np.asarray(decode_image_png_u8(data, size, "rgb"))

    return decode


@cache
def _imagecodecs() -> _Decoder | None:
    try:
        from imagecodecs import SPNG, spng_decode
    except ImportError:  # it is not there, or was built for another NumPy
        return None
    return (lambda data, _: spng_decode(data)) if SPNG.available else None
