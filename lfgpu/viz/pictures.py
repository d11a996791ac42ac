"""Maps as pictures with a colour bar, drawn with Pillow: matplotlib takes longer to import than these take to draw."""

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
from lfgpu.viz.colours import GREYS, LOOKS, PAPER, STEPS, indices, palette
from lfgpu.viz.scales import scale_limits

_LEAST_PIXELS = 900  # at least, the longer side of a map in the picture
_LONGEST_NAME = 34  # characters
_MOST_TICKS = 9
_BESIDE = 600  # pixels that the sizes of a scale are shares of, beside a picture that is shown as it is
_FONT = "mpl-data/fonts/ttf/DejaVuSans.ttf"
_TEXT, _TITLE = 1 / 43, 1 / 36  # of the longer side: the height of letters
_MARGIN, _BAR, _GAP, _TICK = 0.025, 0.033, 0.025, 0.008  # of the longer side
_LEAST_HEIGHT = 0.4  # of the longer side: space for the label of the bar
_COMPRESSION = 1  # of PNG: more takes twice as long and saves a third


def write_disparity(disparity: ArrayLike, path: str | os.PathLike[str], *, name: str) -> None:
    """Write a disparity map [y, x] as PNG, in viridis; as `draw_map` draws it, whole or not at all."""
    look = LOOKS["disparity"]
    save_picture(draw_map(disparity, title=f"{short(name)}: disparity", label=look.title, colours=look.colours), path)


def write_confidence(confidence: ArrayLike, path: str | os.PathLike[str], *, name: str) -> None:
    """Write a confidence map [y, x] as PNG, in cividis, on the scale 0 to 1; whole or not at all."""
    title, look = f"{short(name)}: confidence", LOOKS["confidence"]
    drawn = draw_map(confidence, title=title, label=look.title, colours=look.colours, limits=(0.0, 1.0))
    save_picture(drawn, path)


def save_picture(picture: Image.Image, path: str | os.PathLike[str]) -> None:
    """Save a picture as PNG, whole or not at all; LightFieldError if the file cannot be written."""
    with atomic_write(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=_COMPRESSION)


def draw_map(
    values: ArrayLike, *, title: str, label: str, colours: str, limits: tuple[float, float] | None = None
) -> Image.Image:
    """Draw a map [y, x] with its title and a colour bar; pixels become k x k, unknown ones grey.

    `colours` is a colour map of matplotlib; "viridis" and "cividis" are drawn without it. `limits` (low, high) are by
    default the range of the map without a few outliers. An end of the bar is pointed where values lie beyond it.
    """
    map_ = np.asarray(values, np.float32)
    if map_.ndim != 2 or 0 in map_.shape:
        raise LightFieldError(f"a map must be [y, x]; found shape {map_.shape}.")
    limits = limits or scale_limits(map_)
    magnification = math.ceil(_LEAST_PIXELS / max(map_.shape))
    height, width = (side * magnification for side in map_.shape)
    unit = max(height, width)
    known = map_[np.isfinite(map_)]
    extent = (float(known.min()), float(known.max())) if known.size else limits
    words = label if known.size == map_.size else f"{label}; grey: undefined"
    scale = _scale(max(height, round(_LEAST_HEIGHT * unit)), unit, words, limits, extent)
    heading, margin = font(round(_TITLE * unit)), round(_MARGIN * unit)
    line, right = margin + round(1.6 * _TITLE * unit), margin + max(width, round(heading.getlength(title)))
    y = max(line, margin + (len(scale) - height) // 2)  # of the map, in the middle of the scale
    top = y - (len(scale) - height) // 2
    inked = Image.new("L", (right + scale.shape[1], top + len(scale) + margin), 0)
    ImageDraw.Draw(inked).text((margin, line - margin / 2), title, 255, heading, "ls")
    pixels = _greys(inked)
    pixels[top : top + len(scale), right:] = scale
    shown = indices(map_, limits).repeat(magnification, 0).repeat(magnification, 1)
    pixels[y : y + height, margin : margin + width] = shown
    picture = Image.fromarray(pixels, "P")
    picture.putpalette(palette(colours).tobytes())
    return picture


def draw_view(picture: NDArray[np.uint8], *, title: str) -> Image.Image:
    """Draw a picture, uint8 [y, x, 3], with its title, as large as `draw_map` draws a map of its size."""
    magnification = math.ceil(_LEAST_PIXELS / max(picture.shape))
    large = picture.repeat(magnification, 0).repeat(magnification, 1)
    unit = max(large.shape)
    margin = round(_MARGIN * unit)
    line = margin + round(1.6 * _TITLE * unit)
    paper = Image.new("RGB", (large.shape[1] + 2 * margin, line + len(large) + margin), "white")
    ImageDraw.Draw(paper).text((margin, line - margin / 2), title, "black", font(round(_TITLE * unit)), "ls")
    paper.paste(Image.fromarray(large), (margin, line))
    return paper


def beside_scale(
    picture: NDArray[np.uint8],
    *,
    label: str,
    colours: str,
    limits: tuple[float, float],
    extent: tuple[float, float],
    paper: tuple[int, int, int] = (255, 255, 255),
) -> Image.Image:
    """Put the scale of its colours beside a picture, uint8 [y, x, 3], whose pixels stay as they are.

    `limits` are the ends of the scale, `extent` the smallest and largest value: an end that one exceeds is pointed.
    """
    height = len(picture)
    scale = _scale(round(0.9 * min(height, _BESIDE)), _BESIDE, label, limits, extent)
    over = max(0, (len(scale) - height + 1) // 2)
    scale = scale[over : over + height]  # of a small picture, words are cut off
    beside = np.full((height, scale.shape[1]), PAPER, np.uint8)
    top = (height - len(scale)) // 2
    beside[top : top + len(scale)] = scale
    return Image.fromarray(np.concatenate([picture, palette(colours, paper)[beside]], axis=1))


def ticks(low: float, high: float, most: int = _MOST_TICKS) -> list[float]:
    """Choose round numbers within a scale, at most `most`, at equal distances."""
    least = (high - low) / (most - 1)
    unit = 10.0 ** math.floor(math.log10(least))
    step = next(unit * factor for factor in (1, 2, 2.5, 5, 10) if unit * factor >= least * (1 - 1e-9))
    return [k * step for k in range(math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6) + 1)]


def _scale(
    tall: int, unit: int, label: str, limits: tuple[float, float], extent: tuple[float, float]
) -> NDArray[np.uint8]:
    """Draw a colour bar `tall` pixels high with its numbers and words, as places in a palette [y, x].

    Sizes of letters and lines are shares of `unit` pixels. The bar is in the middle, with as much above as below it.
    """
    gap, bar, tick, margin = (round(share * unit) for share in (_GAP, _BAR, _TICK, _MARGIN))
    text, line, point = font(round(_TEXT * unit)), round(1.5 * _TEXT * unit), round(bar / 2)
    low, high = limits
    marks = {value: f"{value:.6g}".replace("-", "\N{MINUS SIGN}") for value in ticks(low, high)}
    wide = max(round(text.getlength(mark)) for mark in (*marks.values(), " "))
    words = Image.new("L", (max(tall, round(text.getlength(label)) + 1), line), 0)
    ImageDraw.Draw(words).text((words.width / 2, line / 2), label, 255, text, "mm")
    height = max(tall + 2 * point, words.width)
    top, right, ends = (height - tall) // 2, gap + bar, gap + bar + 2 * tick + wide
    inked = Image.new("L", (ends + gap + line + margin, height), 0)
    draw = ImageDraw.Draw(inked)
    inked.paste(words.rotate(90, expand=True), (ends + gap, (height - words.width) // 2))
    for value, mark in marks.items():
        y = top + (high - value) / (high - low) * (tall - 1)
        draw.line([(right, y), (right + tick, y)], 255)
        draw.text((right + 2 * tick, y), mark, 255, text, "lm")
    pixels = _greys(inked)
    pixels[top : top + tall, gap:right] = np.linspace(STEPS - 1, 0, tall).round().astype(np.uint8)[:, None]
    aside = np.abs(np.arange(bar) - (bar - 1) / 2)  # how far from the middle of the bar
    for beyond, step, begin, down in ((extent[1] > high, STEPS - 1, top - 1, -1), (extent[0] < low, 0, top + tall, 1)):
        for k in range(point if beyond else 0):
            pixels[begin + down * k, gap:right][aside < (1 - k / point) * bar / 2] = step
    return pixels


def _greys(inked: Image.Image) -> NDArray[np.uint8]:
    """Return the places in a palette of a picture that says how much ink there is."""
    return (PAPER + (np.asarray(inked, np.uint16) * (GREYS - 1) + 127) // 255).astype(np.uint8)


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Load matplotlib's letters without importing it; Pillow's, which are fewer, where its files lie elsewhere."""
    spec = find_spec("matplotlib")
    for folder in (spec and spec.submodule_search_locations) or ():
        with suppress(OSError):
            return ImageFont.truetype(Path(folder) / _FONT, max(size, 1))
    return ImageFont.load_default(size)


def short(name: str) -> str:
    """Cut a long name off."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 3]}..."
