"""Panels for pages and notebooks, as arrays of pixels: views with their EPIs, maps with their scale."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, get_data_path
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lfgpu.data.lightfield import LightField

Picture = NDArray[np.uint8]
"""An RGB picture, uint8 [y, x, 3]."""

_WIDE, _TALL = 960, 620  # pixels: the largest panel
_GAP = 8
_EPI = 120  # pixels, roughly: the height of an EPI
_PAPER, _INK, _MUTED = (255, 255, 255), (33, 37, 41), (134, 142, 150)
UNDEFINED = (158, 158, 158)
_CURSOR, SLOPE = (255, 255, 255), (255, 64, 129)
_BAR, _LABELS = 22, 96
_TEXT = 18


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
    "unexplained": Look("magma", "difference between views, share of full intensity (rms)"),
    "predicted": Look("viridis", "predicted views: PSNR, dB (larger is better)"),
}


def rgb(view: NDArray[Any], scale: float) -> Picture:
    """A view [y, x, c], as stored, as an RGB picture; `scale` turns stored values into intensities."""
    pixels = view if view.dtype == np.uint8 else np.clip(view * (255 * scale) + 0.5, 0, 255).astype(np.uint8)
    return np.broadcast_to(pixels, (*pixels.shape[:2], 3)) if pixels.shape[2] == 1 else pixels


def fitted(picture: Picture, *, wide: int = _WIDE, tall: int = _TALL) -> Image.Image:
    """A picture scaled to the largest size within a box; enlarged pixels stay sharp squares."""
    height, width = picture.shape[:2]
    factor = min(wide / width, tall / height)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    image = Image.fromarray(np.ascontiguousarray(picture))
    if factor >= 1:
        return image.resize(size, Image.Resampling.NEAREST)
    return image.resize(size, Image.Resampling.BOX, reducing_gap=1.0)


def view_with_epis(
    lf: LightField, index: int, x: int, y: int, slope: float | None, *, wide: int = _WIDE, tall: int = _TALL
) -> Picture:
    """Draw a view with two EPIs: that of image row `y` below it, and that of image column `x` at its right.

    `slope` is the disparity at (x, y) of the reference view, or None or NaN if it is unknown. A line of this slope
    through each EPI marks that point in all views. The EPIs are aligned with the pixels of the view.
    """
    row, column = lf.row(), lf.column()
    across, down = (_epi_height(len(line)) if len(line) > 1 else 0 for line in (row, column))
    image = fitted(
        rgb(lf.views[index], lf.scale),
        wide=wide - (down + _GAP if down else 0),
        tall=tall - (across + _GAP if across else 0),
    )
    width, height = image.size
    factor = width / lf.size[1]
    size = width + (down + _GAP if down else 0), height + (across + _GAP if across else 0)
    canvas = Image.new("RGB", size, _PAPER)
    canvas.paste(image, (0, 0))
    _cross(canvas, ((x + 0.5) * factor, (y + 0.5) * factor), (width, height))
    if across:
        canvas.paste(Image.fromarray(epi_of_row(lf, x, y, slope, wide=width)), (0, height + _GAP))
    if down:
        epi = Image.fromarray(epi_of_column(lf, x, y, slope, wide=height))
        canvas.paste(epi.transpose(Image.Transpose.TRANSPOSE), (width + _GAP, 0))
    return np.asarray(canvas)


def epi_of_row(lf: LightField, x: int, y: int, slope: float | None, *, wide: int) -> Picture:
    """Draw the EPI of image row `y` in the reference view's row of views, with a line of `slope` through `x`."""
    return _epi(lf.epi_horizontal(y), lf.scale, lf.offsets[lf.row(), 0], x, slope, wide)


def epi_of_column(lf: LightField, x: int, y: int, slope: float | None, *, wide: int) -> Picture:
    """Draw the EPI of image column `x`, with image rows from left to right and a line of `slope` through `y`."""
    return _epi(lf.epi_vertical(x), lf.scale, lf.offsets[lf.column(), 1], y, slope, wide)


@dataclass(frozen=True)
class Shown:
    """A map and its name."""

    values: NDArray[np.float32]
    name: str


def map_picture(
    first: Shown,
    kind: str,
    limits: tuple[float, float],
    *,
    second: Shown | None = None,
    wipe: float = 1.0,
    cursor: tuple[int, int] | None = None,
    wide: int = _WIDE,
    tall: int = _TALL,
) -> Picture:
    """Draw a map with its scale and unit, and optionally a second map right of a wipe line.

    `wipe` is the share of the width, from the left, that shows the first map. Both maps have the same scale. Undefined
    pixels are grey. A pointed end of the scale means that values lie beyond it.
    """
    look = LOOKS[kind]
    coloured = colour(first.values, look.colours, limits)
    both = [first.values]
    edge = None
    if second is not None and second.values.shape == first.values.shape:
        edge = round(np.clip(wipe, 0, 1) * coloured.shape[1])
        coloured[:, edge:] = colour(second.values, look.colours, limits)[:, edge:]
        both.append(second.values)
    heading, foot = _TEXT + 10, _TEXT + 10
    image = fitted(coloured, wide=wide - _BAR - _LABELS - _GAP, tall=tall - heading - foot)
    canvas = Image.new("RGB", (image.width + _GAP + _BAR + _LABELS, image.height + heading + foot), _PAPER)
    canvas.paste(image, (0, heading))
    draw = ImageDraw.Draw(canvas)
    factor = image.width / coloured.shape[1]
    if edge is None:
        draw.text((0, 2), first.name, fill=_INK, font=_font())
    else:
        assert second is not None
        draw.text((0, 2), f"◀ {first.name}", fill=_INK, font=_font())
        draw.text((image.width, 2), f"{second.name} ▶", fill=_INK, font=_font(), anchor="ra")
        at = min(edge * factor, image.width - 1)
        draw.line([(at, heading), (at, heading + image.height)], fill=_CURSOR, width=3)
    if cursor is not None:
        _cross(canvas, ((cursor[0] + 0.5) * factor, heading + (cursor[1] + 0.5) * factor), image.size, top=heading)
    _scale(draw, look.colours, limits, (image.width + _GAP, heading, image.height), _beyond(both, limits))
    undefined = any(not np.isfinite(values).all() for values in both)
    label = f"{look.unit}{'; grey: undefined' if undefined else ''}"
    length = draw.textlength(label, font=_font())
    if length > canvas.width:
        canvas = canvas.crop((0, 0, math.ceil(length), canvas.height))
        ImageDraw.Draw(canvas).rectangle((image.width + _GAP + _BAR + _LABELS, 0, canvas.width, canvas.height), _PAPER)
        draw = ImageDraw.Draw(canvas)
    draw.text((0, heading + image.height + 6), label, fill=_MUTED, font=_font())
    return np.asarray(canvas)


def notice(text: str, *, wide: int = _WIDE, tall: int = _TALL) -> Picture:
    """Draw a sentence in place of a picture."""
    canvas = Image.new("RGB", (wide, tall), (245, 246, 247))
    ImageDraw.Draw(canvas).text((wide / 2, tall / 2), text, fill=_MUTED, font=_font(), anchor="mm")
    return np.asarray(canvas)


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


def centred(picture: Picture, wide: int = _WIDE) -> Picture:
    """Pad a picture at both sides to a common width."""
    beside = max(0, wide - picture.shape[1])
    return np.pad(picture, ((0, 0), (beside // 2, beside - beside // 2), (0, 0)), constant_values=255)


def _epi(
    lines: NDArray[Any], scale: float, offsets: NDArray[np.float64], at: int, slope: float | None, wide: int
) -> Picture:
    """Draw an EPI, `lines` [view, pixel, c], `wide` pixels wide; each view is an integer number of pixels high."""
    height, factor = _epi_height(len(lines)), wide / lines.shape[1]
    epi = Image.fromarray(np.ascontiguousarray(rgb(lines, scale))).resize((wide, height), Image.Resampling.NEAREST)
    if slope is not None and math.isfinite(slope):
        thick = height / len(offsets)
        places = (at + 0.5 - slope * offsets) * factor
        line = [(float(place), (i + 0.5) * thick) for i, place in enumerate(places) if 0 <= place < wide]
        draw = ImageDraw.Draw(epi)
        for shade, width in ((_INK, 7), (SLOPE, 3)):
            draw.line(line, fill=shade, width=width)
    return np.asarray(epi)


def _epi_height(views: int) -> int:
    """The height of an EPI: an integer number of pixels for each view."""
    return views * max(3, round(_EPI / views))


def _cross(canvas: Image.Image, at: tuple[float, float], size: tuple[int, int], top: int = 0) -> None:
    """Draw translucent cross hairs over the area of `size` below `top`."""
    layer = Image.new("RGBA", canvas.size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    x, y = at
    for shade, width in (((0, 0, 0, 90), 3), ((255, 255, 255, 200), 1)):
        draw.line([(0, y), (size[0] - 1, y)], fill=shade, width=width)
        draw.line([(x, top), (x, top + size[1] - 1)], fill=shade, width=width)
    canvas.paste(Image.alpha_composite(canvas.convert("RGBA"), layer).convert("RGB"))


def _scale(
    draw: ImageDraw.ImageDraw,
    colours: str,
    limits: tuple[float, float],
    place: tuple[int, int, int],
    beyond: tuple[bool, bool],
) -> None:
    left, top, height = place
    table = colormaps[colours](np.linspace(1, 0, height))[:, :3]
    for line, shade in enumerate(table):
        fill = tuple(int(255 * part + 0.5) for part in shade)
        draw.line([(left, top + line), (left + _BAR - 1, top + line)], fill=fill)
    middle, tip = left + _BAR / 2, _BAR * 0.7
    low, high = limits
    for is_beyond, edge, point in ((beyond[0], top + height, top + height - tip), (beyond[1], top, top + tip)):
        if is_beyond:  # white corners make the end pointed
            for corner in (left - 1, left + _BAR):
                draw.polygon([(corner, edge), (middle, edge), (corner, point)], fill=_PAPER)
    for tick in MaxNLocator(6).tick_values(low, high):
        if low - 1e-9 <= tick <= high + 1e-9 and high > low:
            y = top + (high - tick) / (high - low) * (height - 1)
            draw.line([(left + _BAR, y), (left + _BAR + 5, y)], fill=_INK)
            y = min(max(y, top + _TEXT / 2), top + height - _TEXT / 2)
            draw.text((left + _BAR + 9, y), f"{round(float(tick), 10):g}", fill=_INK, font=_font(), anchor="lm")


def _beyond(maps: list[NDArray[np.float32]], limits: tuple[float, float]) -> tuple[bool, bool]:
    with np.errstate(invalid="ignore"):
        finite = [values[np.isfinite(values)] for values in maps]
    return any((v < limits[0]).any() for v in finite), any((v > limits[1]).any() for v in finite)


@cache
def _font() -> ImageFont.FreeTypeFont:
    """The font of matplotlib, which has more characters than the one of Pillow."""
    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), _TEXT)
