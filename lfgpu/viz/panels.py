"""Looks of maps, and pictures of views, maps and EPIs as arrays of pixels, for pages and notebooks."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image

from lfgpu.data.lightfield import LightField

Picture = NDArray[np.uint8]
"""An RGB picture, uint8 [y, x, 3]."""

_EPI = 120  # pixels, roughly: the height of an EPI
UNDEFINED = (158, 158, 158)
SLOPE = (255, 64, 129)


@dataclass(frozen=True)
class Look:
    """The colour map and the label of one kind of map."""

    colours: str
    unit: str


LOOKS = {
    "disparity": Look("viridis", "disparity, px per view step (larger is nearer)"),
    "depth": Look("viridis_r", "depth, m"),
    "confidence": Look("cividis", "confidence (larger is surer)"),
    "error": Look("RdBu_r", "error, px per view step (red: too near, blue: too far)"),
    "uncertainty": Look("magma", "expected error, px per view step (standard deviation)"),
    "unexplained": Look("magma", "rms difference of the other views, share of full intensity"),
    "predicted": Look("viridis", "predicted views: PSNR, dB (larger is better)"),
}


def rgb(view: NDArray[Any], scale: float) -> Picture:
    """A view [y, x, c], as stored, as an RGB picture; `scale` turns stored values into intensities."""
    pixels = view if view.dtype == np.uint8 else np.clip(view * (255 * scale) + 0.5, 0, 255).astype(np.uint8)
    return np.broadcast_to(pixels, (*pixels.shape[:2], 3)) if pixels.shape[2] == 1 else pixels


def fitted(picture: Picture, *, wide: int, tall: int) -> Image.Image:
    """A picture scaled to the largest size within a box; enlarged pixels stay sharp squares."""
    height, width = picture.shape[:2]
    factor = min(wide / width, tall / height)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    image = Image.fromarray(np.ascontiguousarray(picture))
    if factor >= 1:
        return image.resize(size, Image.Resampling.NEAREST)
    return image.resize(size, Image.Resampling.BOX, reducing_gap=1.0)


def epi_of_row(lf: LightField, y: int, *, wide: int) -> Picture:
    """Draw the EPI of image row `y` in the reference view's row of views, `wide` pixels wide."""
    return _epi(lf.epi_horizontal(y), lf.scale, wide)


def epi_of_column(lf: LightField, x: int, *, wide: int) -> Picture:
    """Draw the EPI of image column `x`, with image rows from left to right, `wide` pixels wide."""
    return _epi(lf.epi_vertical(x), lf.scale, wide)


def colour(values: NDArray[np.float32], colours: str, limits: tuple[float, float]) -> Picture:
    """Apply a colour map to a map; undefined pixels are grey."""
    low, high = limits
    table = (colormaps[colours](np.linspace(0, 1, 256))[:, :3] * 255 + 0.5).astype(np.uint8)
    defined = np.isfinite(values)
    places = np.clip((np.where(defined, values, low) - low) * (255 / max(high - low, 1e-12)) + 0.5, 0, 255)
    picture = table[places.astype(np.uint8)]
    picture[~defined] = UNDEFINED
    return picture


def encoded(picture: Picture, kind: str = "PNG") -> bytes:
    """A picture as the bytes of an image file."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(buffer, kind)
    return buffer.getvalue()


def _epi(lines: NDArray[Any], scale: float, wide: int) -> Picture:
    """Draw an EPI, `lines` [view, pixel, c]; each view is an integer number of pixels high."""
    height = len(lines) * max(3, round(_EPI / len(lines)))
    epi = Image.fromarray(np.ascontiguousarray(rgb(lines, scale)))
    return np.asarray(epi.resize((wide, height), Image.Resampling.NEAREST))
