"""PNG files: written by Pillow where Pillow can, and decoded by imagecodecs where it is installed (extra `png`)."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_CHANNELS = {"L": (), "RGB": (3,)}
_NOT_PLAIN = ("transparency", "interlace")


def decode_fast(path: Path, image: Image.Image) -> NDArray[np.uint8] | None:
    """Decode a grey or RGB PNG of 8 bits that Pillow has opened in half the time by imagecodecs; None for others."""
    tiles = getattr(image, "tile", None)
    plain = image.mode in _CHANNELS and tiles and tiles[0][3] == image.mode
    plain = plain and not getattr(image, "is_animated", False)
    if image.format != "PNG" or not plain or any(name in image.info for name in _NOT_PLAIN):
        return None
    try:
        from imagecodecs import spng_decode

        pixels = spng_decode(path.read_bytes())
    except Exception:  # it is not there or built for another NumPy, or the file is damaged
        return None
    wanted = (image.height, image.width, *_CHANNELS[image.mode])
    return pixels if pixels.dtype == np.uint8 and pixels.shape == wanted else None


def write_png(path: Path, image: NDArray[Any]) -> None:
    """Write [y, x, c], c = 1 or 3: uint8 and uint16 without loss, floats in [0, 1] in 16 bits, bool as 0 and 255."""
    if image.dtype.kind in "bf":
        image = quantised(image, np.uint8 if image.dtype == np.bool_ else np.uint16)
    if image.dtype == np.uint16 and image.shape[2] == 3:
        path.write_bytes(_encode_rgb16(image))
    else:
        Image.fromarray(image if image.shape[2] == 3 else image[..., 0]).save(path, format="PNG")


def quantised(image: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Convert values in [0, 1] to whole numbers up to the largest of a type; others are cut off."""
    return np.rint(np.clip(image, 0, 1) * np.float32(np.iinfo(dtype).max)).astype(dtype)


def _encode_rgb16(image: NDArray[np.uint16]) -> bytes:
    """Encode 16-bit colour, which Pillow reads but cannot write."""
    height, width, _ = image.shape
    pixels = image.astype(">u2").view(np.uint8).reshape(height, width, 6)
    # Each row begins with its filter: 1 stores the difference from the pixel to the left, which packs better.
    rows = np.ones((height, 1 + width * 6), np.uint8)
    rows[:, 1:] = np.diff(pixels, axis=1, prepend=np.uint8(0)).reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
