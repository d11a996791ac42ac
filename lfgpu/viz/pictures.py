"""A map as a picture with a colour bar, drawn with Pillow: it is written before matplotlib would be imported.

The picture has a palette: the steps of the colour map, the grey of what is undefined, and greys for the text.
"""

from __future__ import annotations

import math
import os
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_write
from lfgpu.viz.scales import scale_limits

_TABLES = {
    "viridis": (
        "44015446085c471063481769481d6f482475472a7a46307e453781433d844142873f48893d4e8a3a538b38598c355e8d33638d31688e"
        "2e6d8e2c718e2a768e297b8e27808e25848e23898e218e8d20928c1f978b1e9c891fa18821a58524aa8328ae802eb37c35b7793dbc74"
        "46c06f50c46a5ac86465cb5e70cf577cd25089d54895d840a2da37b0dd2fbddf26cae11fd8e219e5e419f1e51dfde725"
    ),
    "cividis": (
        "00224e002656002a5f002d68003070083370163770203a6f273e6e2e416d34456c3a486c3f4c6c444f6c49536c4e566c535a6d575d6d"
        "5c616e60646f656870696b716d6f727272747676767a7a787e7d788381798885788d8878928c789690779b9476a09875a59c74aaa073"
        "afa471b5a86fbaac6dbfb06bc4b468c9b965cfbd62d4c15fdac65bdfca57e5cf52ead34cf0d846f6dd3ffce236fee838"
    ),
}
"""Colours from low to high, red, green and blue, in equal steps; matplotlib's maps of these names."""

_STEPS, _GREYS = 239, 16  # of the palette: of the colour map, and from white to black
_UNDEFINED, _WHITE, _BLACK = _STEPS, _STEPS + 1, 255
_GREY = 158  # occurs in none of the colour maps
_LEAST_PIXELS = 900  # at least, the longer side of a map in the picture
_LONGEST_NAME = 34  # characters
_MOST_TICKS = 9
_FONT = "mpl-data/fonts/ttf/DejaVuSans.ttf"
_TEXT, _TITLE = 1 / 43, 1 / 36  # of the longer side: the height of letters
_MARGIN, _BAR, _GAP, _TICK = 0.025, 0.033, 0.025, 0.008  # of the longer side
_LEAST_HEIGHT = 0.4  # of the longer side: space for the label of the bar
_COMPRESSION = 1  # of PNG: more takes twice as long and saves a third


def write_disparity(disparity: ArrayLike, path: str | os.PathLike[str], *, name: str) -> None:
    """Write a disparity map [y, x] as PNG, in viridis; as `write_picture`."""
    label = "disparity (px per view step), larger is nearer"
    write_picture(disparity, path, title=f"{_short(name)}: disparity", label=label)


def write_confidence(confidence: ArrayLike, path: str | os.PathLike[str], *, name: str) -> None:
    """Write a confidence map [y, x] as PNG, in cividis, on the scale 0 to 1; as `write_picture`."""
    title, label = f"{_short(name)}: confidence", "confidence, larger is surer"
    write_picture(confidence, path, title=title, label=label, colours="cividis", limits=(0.0, 1.0))


def write_picture(
    values: ArrayLike,
    path: str | os.PathLike[str],
    *,
    title: str,
    label: str,
    colours: str = "viridis",
    limits: tuple[float, float] | None = None,
) -> None:
    """Write a map as PNG with a colour bar, whole or not at all.

    Parameters
    ----------
    values
        [y, x]; NaN and infinite pixels are grey. A pixel becomes k x k pixels, with an integer k.
    path
        The file.
    title
        The title.
    label
        What the colour bar shows, with its unit.
    colours
        "viridis" (default) or "cividis".
    limits
        (low, high) of the scale. Default None: the range of the map without a few outliers. An end of the bar is
        pointed where values lie beyond it.

    Raises
    ------
    LightFieldError
        If the map is not [y, x], or the file cannot be written.
    """
    map_ = np.asarray(values, np.float32)
    if map_.ndim != 2 or 0 in map_.shape:
        raise LightFieldError(f"a map must be [y, x]; found shape {map_.shape}.")
    picture = _drawn(map_, title, label, colours, limits or scale_limits(map_))
    with atomic_write(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=_COMPRESSION)


def palette(colours: str) -> NDArray[np.uint8]:
    """The palette [256, 3] of pictures: `_STEPS` of the colour map, the grey of what is undefined, white to black."""
    table = np.frombuffer(bytes.fromhex(_TABLES[colours]), np.uint8).reshape(-1, 3)
    at = np.linspace(0, len(table) - 1, _STEPS)
    steps = np.stack([np.interp(at, np.arange(len(table)), table[:, c]) for c in range(3)], axis=1)
    greys = np.repeat(np.linspace(255, 0, _GREYS)[:, None], 3, axis=1)
    return np.round(np.concatenate([steps, [[_GREY] * 3], greys])).astype(np.uint8)


def indices(values: NDArray[np.float32], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """The places in the palette of a map [y, x]."""
    low, high = limits
    share = (values - np.float32(low)) * np.float32(1 / max(high - low, 1e-30))
    known = np.isfinite(values)
    steps = np.clip(np.where(known, share, 0) * (_STEPS - 1) + 0.5, 0, _STEPS - 1)
    return np.where(known, steps, _UNDEFINED).astype(np.uint8)


def ticks(low: float, high: float) -> list[float]:
    """Round numbers within a scale, at most nine, at equal distances."""
    least = (high - low) / (_MOST_TICKS - 1)
    unit = 10.0 ** math.floor(math.log10(least))
    step = next(unit * factor for factor in (1, 2, 2.5, 5, 10) if unit * factor >= least * (1 - 1e-9))
    return [k * step for k in range(math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6) + 1)]


def _drawn(
    values: NDArray[np.float32], title: str, label: str, colours: str, limits: tuple[float, float]
) -> Image.Image:
    magnification = math.ceil(_LEAST_PIXELS / max(values.shape))
    height, width = (side * magnification for side in values.shape)
    longer = max(height, width)
    margin, bar, gap, tick = (round(share * longer) for share in (_MARGIN, _BAR, _GAP, _TICK))
    text, heading = (_font(round(share * longer)) for share in (_TEXT, _TITLE))
    tall = max(height, round(_LEAST_HEIGHT * longer))
    marks = {value: f"{value:.6g}".replace("-", "\N{MINUS SIGN}") for value in ticks(*limits)}
    if not np.isfinite(values).all():
        label += "; grey: undefined"
    line = round(1.5 * _TEXT * longer)
    top = margin + round(1.6 * _TITLE * longer)
    right = margin + max(width, round(heading.getlength(title))) + gap
    ends = right + bar + 2 * tick + max(round(text.getlength(mark)) for mark in (*marks.values(), " "))
    written = Image.new("L", (max(tall, round(text.getlength(label)) + 1), line), 0)  # how black, along the bar
    ImageDraw.Draw(written).text((written.width / 2, line / 2), label, 255, text, "mm")
    foot = top + max(tall, written.width)

    inked = Image.new("L", (ends + gap + line + margin, foot + margin), 0)
    draw = ImageDraw.Draw(inked)
    draw.text((margin, top - margin / 2), title, 255, heading, "ls")
    inked.paste(written.rotate(90, expand=True), (ends + gap, top + (foot - top - written.width) // 2))
    low, high = limits
    for value, mark in marks.items():
        y = top + (high - value) / (high - low) * (tall - 1)
        draw.line([(right + bar, y), (right + bar + tick, y)], 255)
        draw.text((right + bar + 2 * tick, y), mark, 255, text, "lm")

    pixels = (_WHITE + (np.asarray(inked, np.uint16) * (_GREYS - 1) + 127) // 255).astype(np.uint8)
    y, x = top + (tall - height) // 2, margin
    shown = indices(values, limits)
    pixels[y : y + height, x : x + width] = shown.repeat(magnification, 0).repeat(magnification, 1)
    steps = np.linspace(_STEPS - 1, 0, tall).round().astype(np.uint8)
    pixels[top : top + tall, right : right + bar] = steps[:, None]
    defined = values[np.isfinite(values)]
    point = np.abs(np.arange(bar) - (bar - 1) / 2)  # how far from its middle
    rows = min(round(bar / 2), margin // 2 + bar)
    for beyond, step, from_, sign in (
        (bool((defined > high).any()), _STEPS - 1, top - 1, -1),
        (bool((defined < low).any()), 0, top + tall, 1),
    ):
        for k in range(rows if beyond else 0):
            pixels[from_ + sign * k, right : right + bar][point < (1 - k / rows) * bar / 2] = step
    picture = Image.fromarray(pixels, "P")
    picture.putpalette(palette(colours).tobytes())
    return picture


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """matplotlib's letters, read without importing it; Pillow's, which are fewer, where its files lie elsewhere."""
    spec = find_spec("matplotlib")
    for folder in (spec and spec.submodule_search_locations) or ():
        with suppress(OSError):
            return ImageFont.truetype(Path(folder) / _FONT, size)
    return ImageFont.load_default(size)


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 3]}..."
