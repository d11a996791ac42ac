"""Pictures of views as arrays of pixels, for pages and notebooks."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Picture = NDArray[np.uint8]
"""An RGB picture, uint8 [y, x, 3]."""

SLOPE = (255, 64, 129)


def rgb(view: NDArray[Any], scale: float) -> Picture:
    """Convert a view [y, x, c], as stored, to an RGB picture; `scale` turns stored values into intensities."""
    pixels = view if view.dtype == np.uint8 else np.clip(view * (255 * scale) + 0.5, 0, 255).astype(np.uint8)
    return np.broadcast_to(pixels, (*pixels.shape[:2], 3)) if pixels.shape[2] == 1 else pixels


def fitted(picture: Picture, *, wide: int, tall: int) -> Image.Image:
    """Scale a picture to the largest size within a box; enlarged pixels stay sharp squares."""
    height, width = picture.shape[:2]
    factor = min(wide / width, tall / height)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    image = Image.fromarray(np.ascontiguousarray(picture))
    if factor >= 1:
        return image.resize(size, Image.Resampling.NEAREST)
    return image.resize(size, Image.Resampling.BOX, reducing_gap=1.0)


def encoded(picture: Picture | Image.Image) -> bytes:
    """Encode a picture as PNG."""
    buffer = io.BytesIO()
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(np.ascontiguousarray(picture))
    image.save(buffer, "PNG")
    return buffer.getvalue()
