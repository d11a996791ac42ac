"""Cards: pictures for pages, each with its title and its scale; and tiles, numbers with their titles."""

import base64
import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from lfgpu.data import DisparityMap
from lfgpu.viz.colours import GREY, LOOKS, indices, palette, shades
from lfgpu.viz.panels import Picture, fitted
from lfgpu.viz.pictures import ticks
from lfgpu.viz.scales import ERRORS, scale_limits

MOST_PIXELS = 500_000
"""Pixels of a picture in a page: larger ones are scaled down, so that the page stays at a few MB."""

SAVING: dict[str, dict[str, Any]] = {"JPEG": {"quality": 88}, "PNG": {"compress_level": 4}}
"""Options of Pillow by the name of the format. Level 4 takes a sixth of the time of the best, for 6 % more bytes."""

_SHARP = 480  # pixels: pictures whose longer side is shorter are enlarged in sharp squares
_STOPS = 17
_TICKS = 7  # at most
_MOST_OF_ALL = 0.98  # share of the values that end a scale which begins at zero
_THIN, _THICK = 1 / 450, 1 / 190  # width of a line, as a share of the picture's: without and with a letter


@dataclass(frozen=True)
class Tick:
    """A number at a scale."""

    place: float  # percent of the length of the scale, from its low end
    text: str


@dataclass(frozen=True)
class Scale:
    """The scale of a map."""

    stops: tuple[str, ...]  # its colours, from low to high, at equal distances
    ticks: tuple[Tick, ...]  # the numbers beside it
    unit: str  # what the numbers are, and what grey means
    below: bool = False  # True if values lie beyond that end; an arrow shows it
    above: bool = False


@dataclass(frozen=True)
class Mark:
    """A line over a picture, with a letter."""

    path: str  # the line, as the data of an SVG path, in pixels of the picture
    letter: str = ""  # beside it; may be empty
    at: tuple[float, float] = (0.0, 0.0)  # (x, y) of the letter, pixels of the picture


@dataclass(frozen=True)
class Card:
    """A picture with its title."""

    title: str  # what it shows
    remark: str = ""
    image: str = ""  # the picture as a data address; empty if it is drawn
    size: tuple[int, int] = (0, 0)  # (width, height) of what it shows, pixels; those of a large picture are fewer
    scale: Scale | None = None
    marks: tuple[Mark, ...] = ()  # lines over the picture
    drawing: Markup | None = None  # SVG in place of the picture

    @property
    def is_small(self) -> bool:
        """True if its pixels are to stay sharp squares when it is enlarged."""
        return max(self.size) < _SHARP

    @property
    def line(self) -> float:
        """The width of a line over it, pixels of the picture."""
        return self.size[0] * (_THICK if any(mark.letter for mark in self.marks) else _THIN)


@dataclass(frozen=True)
class Tile:
    """A number that is read first."""

    label: str
    value: str
    unit: str = ""
    remark: str = ""


def view_card(
    title: str, picture: Picture, *, remark: str = "", marks: tuple[Mark, ...] = (), most: int = MOST_PIXELS
) -> Card:
    """Make a card of a view [y, x, 3], of at most so many pixels. Marks are in the pixels of the view."""
    height, width = picture.shape[:2]
    return Card(title, remark, address(view_image(picture, most=most), "JPEG"), (width, height), marks=marks)


def drawn_card(title: str, picture: Picture, *, remark: str = "", marks: tuple[Mark, ...] = ()) -> Card:
    """Make a card of a picture [y, x, 3] whose pixels have to stay as they are. Marks are in its pixels."""
    return Card(title, remark, address(Image.fromarray(picture), "PNG"), picture.shape[1::-1], marks=marks)


def map_card(
    title: str,
    values: NDArray[np.float32],
    kind: str,
    *,
    limits: tuple[float, float] | None = None,
    remark: str = "",
    most: int = MOST_PIXELS,
) -> Card:
    """Make a card of a map [y, x] of a kind in `LOOKS`, of at most so many pixels.

    Undefined pixels are grey; default limits are `limits_of`.
    """
    low, high = limits if limits is not None else limits_of(kind, values)
    image = map_image(values, kind, (low, high), most=most)
    return Card(title, remark, address(image, "PNG"), values.shape[::-1], scale=scale_of(kind, values, (low, high)))


def trust_cards(map_: DisparityMap) -> list[Card]:
    """Make the cards of the confidence and the uncertainty that a map has."""
    cards = []
    if map_.confidence is not None:
        known = np.where(np.isfinite(map_.disparity), map_.confidence, np.float32(np.nan))
        cards.append(map_card("Confidence", known, "confidence"))
    if map_.uncertainty is not None:
        cards.append(map_card("Uncertainty", map_.uncertainty, "uncertainty"))
    return cards


def limits_of(kind: str, values: NDArray[np.float32]) -> tuple[float, float]:
    """Return the ends of the scale of a map of a kind in `LOOKS`."""
    if kind == "confidence":
        return 0.0, 1.0
    if kind == "error":
        return ERRORS
    if kind in ("uncertainty", "unexplained"):
        known = values[np.isfinite(values)]
        high = float(np.quantile(known, _MOST_OF_ALL)) if known.size else 0.0
        return 0.0, high if high > 0 else 1.0
    return scale_limits(values)


def view_image(picture: Picture, *, most: int = MOST_PIXELS) -> Image.Image:
    """Scale a view [y, x, 3] as a picture of at most so many pixels."""
    height, width = picture.shape[:2]
    wide, tall = _size(width, height, most)
    return fitted(picture, wide=wide, tall=tall) if wide < width else Image.fromarray(np.ascontiguousarray(picture))


def map_image(
    values: NDArray[np.float32], kind: str, limits: tuple[float, float], *, most: int = MOST_PIXELS
) -> Image.Image:
    """Paint a map as a picture with a palette, of at most so many pixels; of a large map some pixels are left out."""
    height, width = values.shape
    wide, tall = _size(width, height, most)
    rows, columns = (((np.arange(n) + 0.5) * of / n).astype(np.intp) for n, of in ((tall, height), (wide, width)))
    shown = values[rows[:, None], columns]
    image = Image.fromarray(indices(shown, limits), "P")
    image.putpalette(palette(LOOKS[kind].colours)[: GREY + 1].tobytes())
    return image


def scale_of(kind: str, values: NDArray[np.float32], limits: tuple[float, float]) -> Scale:
    """Return the scale of a map; arrows where finite values lie beyond it."""
    known, (low, high) = values[np.isfinite(values)], limits
    return scale(
        kind,
        limits,
        below=bool((known < low).any()),
        above=bool((known > high).any()),
        undefined=len(known) < values.size,
    )


def scale(
    kind: str, limits: tuple[float, float], *, below: bool = False, above: bool = False, undefined: bool = False
) -> Scale:
    """Return the scale of a map of which some values lie below or above the limits, or are undefined."""
    low, high = limits
    span = max(high - low, 1e-12)
    return Scale(
        tuple(f"rgb({r} {g} {b})" for r, g, b in shades(LOOKS[kind].colours, _STOPS)),
        tuple(
            Tick(round(100 * (t - low) / span, 2), number(t))
            for t in (ticks(low, high, _TICKS) if high > low else [low])
        ),
        f"{LOOKS[kind].title}{'; grey: undefined' if undefined else ''}",
        below,
        above,
    )


def number(value: float) -> str:
    """Write a number with a true minus sign, without digits that say nothing."""
    return f"{round(value, 10):g}".replace("-", "\u2212")


def address(image: Image.Image, kind: str) -> str:
    """Encode a picture as a data address; `kind` is PNG or JPEG."""
    buffer = io.BytesIO()
    image.save(buffer, kind, **SAVING[kind])
    return f"data:image/{kind.lower()};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def cross_hair(x: float, y: float, size: tuple[int, int], letter: str) -> Mark:
    """Draw cross hairs around a point of a picture of (width, height), open in the middle, a letter beside them."""
    width, height = size
    near, far = 0.022 * width, 0.055 * width
    path = "".join(
        f"M{x + dx * near:.1f} {y + dy * near:.1f}L{x + dx * far:.1f} {y + dy * far:.1f}"
        for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1))
    )
    right, below = x < 0.9 * width, y < 0.1 * height
    at = (x + (0.02 if right else -0.055) * width, y + (0.06 if below else -0.02) * width)
    return Mark(path, letter, at)


def _size(width: int, height: int, most: int) -> tuple[int, int]:
    """Return the size of a picture, scaled down where it has too many pixels."""
    factor = math.sqrt(most / (width * height))
    return (width, height) if factor >= 1 else (max(1, int(width * factor)), max(1, int(height * factor)))
