"""Pillow, opened for the formats of pictures only, and quiet: the one place from which files reach it."""

import ctypes
import io
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile, _imaging

from lfgpu.io.damage import check_claim

FORMATS = ("PNG", "BMP", "DIB", "JPEG", "TIFF", "WEBP", "PPM")
"""Formats that a file may have, whatever its suffix says. Pillow knows more: EPS is a program that Ghostscript runs."""


@contextmanager
def opened(path: Path) -> Iterator[ImageFile.ImageFile]:
    """Open a picture of one of `FORMATS`, of a size that the file can hold; its pixels are decoded within the block.

    Pillow raises whatever comes to it when a file is damaged; UnidentifiedImageError if it is none of `FORMATS`.
    """
    with decoding(path, *FORMATS) as image:
        # Four bytes a pixel whatever the mode: a bound on what decoding takes.
        check_claim(path, (image.height, image.width, 4), np.uint8)
        yield image


@contextmanager
def decoding(source: Path | io.BytesIO, *formats: str) -> Iterator[ImageFile.ImageFile]:
    """Open a picture of some formats, such as JPEG; its pixels are decoded within the block."""
    _silence_libtiff()
    with _FILTERS, Image.open(source, formats=formats) as image:
        yield image


class _Filters:
    """Filters of Pillow's warnings, and no limit of its pixels, while it decodes: `check_claim` knows better.

    Both belong to the whole process: the first of several threads sets them, the last one sets them back.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._before = threading.Lock(), 0, warnings.catch_warnings()
        self._limit = Image.MAX_IMAGE_PIXELS

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                self._before = warnings.catch_warnings()
                self._before.__enter__()
                warnings.simplefilter("ignore", UserWarning)  # of damaged remarks about the image
                self._limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._before.__exit__(None, None, None)
                Image.MAX_IMAGE_PIXELS = self._limit


_FILTERS = _Filters()


@cache
def _silence_libtiff() -> None:
    """Have libtiff write nothing to stderr: what is wrong with a file is raised by Pillow as well."""
    with suppress(OSError, AttributeError, TypeError):  # where Pillow has it built in, its symbols cannot be had
        ctypes.CDLL(_imaging.__file__).TIFFSetErrorHandler(None)
