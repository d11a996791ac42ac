"""Answers to pages, as functions of the contents and the words of a request, without anything of the web."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods import preset
from lfgpu.viewer import pictures, probe, saving, solving
from lfgpu.viewer.board import Board
from lfgpu.viewer.contents import FINAL, QUANTITIES, Contents
from lfgpu.viewer.facts import COLOURS, fixed
from lfgpu.viewer.scene import LARGEST
from lfgpu.viewer.solving import Request

_LONGEST = 200  # characters of the name of a result


class Query:
    """The words of a request, of their types; LightFieldError for what is missing or no number."""

    def __init__(self, words: Mapping[str, str]) -> None:
        self._words = words

    def text(self, name: str, default: str | None = None) -> str:
        """Return a word as it is."""
        found = self._words.get(name, default)
        if found is None:
            raise LightFieldError(f"the argument {name} is missing.")
        return found

    def number(self, name: str) -> float:
        """Return a number of a size that pages need."""
        try:
            found = float(self.text(name))
        except ValueError:
            found = float("nan")
        if not abs(found) <= LARGEST:
            raise LightFieldError(f"{name} must be a number, not {self.text(name)!r}.")
        return found

    def whole(self, name: str) -> int:
        """Return a whole number."""
        return int(np.clip(self.number(name), -(2**31), 2**31))

    def wholes(self, *names: str) -> Iterator[int]:
        """Yield whole numbers."""
        return (self.whole(name) for name in names)


# --- what is drawn ---


def _lf(contents: Contents) -> LightField:
    if contents.lf is None:
        raise LightFieldError("there is no light field.")
    return contents.lf


def _values(contents: Contents, query: Query) -> NDArray[np.float32]:
    name, kind = query.text("result"), query.text("kind")
    values = contents.map(name, kind, query.text("stage", FINAL))
    minus = query.text("minus", "")
    other = contents.map(minus, kind) if minus else None
    if values is None or (minus and other is None):
        raise LightFieldError(f"there is no {kind} of {minus or name!r}.")
    if other is None:
        return values
    with np.errstate(invalid="ignore"):  # both may be infinitely far away
        return values - other


def _at(contents: Contents, query: Query) -> Any:
    """Return the pixel of the reference view that a pixel of a view shows, and the values of two maps there."""
    if contents.size is None:
        return {"pixel": None, "values": {}, "other": {}}
    name, stage = query.text("result", ""), query.text("stage", FINAL)
    x, y, du, dv = (query.number(word) for word in ("x", "y", "du", "dv"))
    found = pictures.in_reference(contents, name, stage, (du, dv), x, y)
    if found is None:
        return {"pixel": None, "values": {}, "other": {}}
    return {
        "pixel": found,
        "colour": pictures.colour_at(contents, (du, dv), x, y),
        "values": pictures.values_at(contents, name, stage, *found),
        "other": pictures.values_at(contents, query.text("other", ""), FINAL, *found),
    }


def _pixel(contents: Contents, query: Query, x: str, y: str) -> tuple[int, int]:
    """Return a pixel of the maps, the nearest one to what is asked for."""
    height, width = contents.size or (1, 1)
    return int(np.clip(query.number(x), 0, width - 1)), int(np.clip(query.number(y), 0, height - 1))


def _span(contents: Contents, query: Query) -> Any:
    name, kind = query.text("result"), query.text("kind")
    ends = [_pixel(contents, query, *words) for words in (("x0", "y0"), ("x", "y"))]
    values, entry = _values(contents, query), contents.all_entries()[name]
    return probe.span(contents, values, entry, query.text("stage", FINAL), ends, QUANTITIES[kind].unit)


def _preview(contents: Contents, query: Query) -> NDArray[np.float32]:
    try:
        wish = dict(json.loads(query.text("wish")))
    except (TypeError, ValueError, RecursionError):
        raise LightFieldError("the wish must be an object in JSON.") from None
    request = _request(contents, wish)
    known = contents.entries.get(query.text("result", ""))
    if request.disparity_range is None and known is not None and known.result is not None:
        request = replace(request, disparity_range=known.result.disparity_range)
    return solving.preview(request, *query.wholes("left", "top", "right", "bottom"))


_TILE = ("level", "column", "row")

DATA: dict[str, Callable[[Contents, Query], Any]] = {
    "view": lambda of, query: pictures.view_tile(_lf(of), *query.wholes("index", *_TILE)),
    "map": lambda of, query: pictures.map_tile(_values(of, query), *query.wholes(*_TILE)),
    "histogram": lambda of, query: pictures.histogram(
        _values(of, query), query.number("low"), query.number("high"), query.whole("bins")
    ),
    "epi": lambda of, query: pictures.epi(_lf(of), query.text("along"), query.whole("at")),
    "thumbnails": lambda of, _: pictures.thumbnails(_lf(of)),
    "refocused": lambda of, query: pictures.refocused(
        _lf(of), query.number("disparity"), query.number("aperture"), *query.wholes(*_TILE, "side")
    ),
    "sharp": lambda of, query: pictures.sharp(
        of, query.text("result"), query.text("stage", FINAL), *query.wholes(*_TILE, "side")
    ),
    "at": _at,
    "costs": lambda of, query: probe.costs(
        of, query.text("result"), query.text("stage", FINAL), *_pixel(of, query, "x", "y")
    ),
    "seen": lambda of, query: probe.seen(_values(of, query), *query.wholes("left", "top", "right", "bottom")),
    "span": _span,
    "preview": _preview,
    "difference": lambda of, query: probe.difference(_values(of, query), query.text("kind")),
    "fixed": lambda *_: fixed(),
}
"""Arrays to draw, and values for JSON, by what is asked for."""


# --- files ---


def _saved(contents: Contents, query: Query) -> tuple[bytes, str]:
    suffix = query.text("suffix")
    return saving.saved(contents, query.text("result"), query.text("stage", FINAL), suffix), suffix


def _figure(contents: Contents, query: Query) -> tuple[bytes, str]:
    kind, colours = query.text("kind"), query.text("colours")
    if kind not in QUANTITIES or colours not in COLOURS:
        raise LightFieldError(f"there is no {kind!r}, or no colours {colours!r}.")
    limits = query.number("low"), query.number("high")
    name, stage = query.text("result"), query.text("stage", FINAL)
    return saving.figure(contents, name, kind, stage, colours=colours, limits=limits), ".png"


def _page(contents: Contents, query: Query) -> tuple[bytes, str]:
    from lfgpu.viewer.standalone import standalone

    return standalone(contents, query.text("sight", "")), ".html"


FILES: dict[str, Callable[[Contents, Query], tuple[bytes, str]]] = {"result": _saved, "figure": _figure, "page": _page}
"""Files to download, with their suffix."""


# --- what is done ---


def _open(board: Board, wish: Mapping[str, Any]) -> None:
    path = str(wish.get("path", "")).strip()
    if not path:
        raise LightFieldError("type the path of a light field, or of what lfgpu depth wrote.")
    try:
        board.open_from_page(Path(path).expanduser())
    except LightFieldError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        raise LightFieldError(f"{path} cannot be opened: {str(error).rstrip('.')}.") from None


def _estimate(board: Board, wish: Mapping[str, Any]) -> None:
    if not board.solver.start(_request(board.contents, wish)):
        raise LightFieldError("an estimate is being made already; wait for it, or press Stop.")


def _request(contents: Contents, wish: Mapping[str, Any]) -> Request:
    values, bounds = wish.get("values") or {}, wish.get("range")
    if contents.lf is None:
        raise LightFieldError("a map alone cannot be estimated again: open the light field that it is of.")
    if not isinstance(values, dict) or not (bounds is None or _are_two_numbers(bounds)):
        raise LightFieldError("the range must be two numbers, from small to large.")
    chosen = str(wish.get("preset", ""))
    config = preset(chosen).with_values({str(key): value for key, value in values.items()})
    name = str(wish.get("name") or "").strip()[:_LONGEST] or chosen
    found = None if bounds is None else (float(bounds[0]), float(bounds[1]))
    return Request(contents.lf, config, found, name, contents.frame)


def _are_two_numbers(values: object) -> bool:
    if not isinstance(values, list) or len(values) != 2:
        return False
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return numbers and all(abs(value) <= LARGEST for value in values)


def _turn(board: Board, wish: Mapping[str, Any]) -> None:
    number = wish.get("frame")
    if not isinstance(number, int):
        raise LightFieldError("the frame must be a whole number.")
    board.turn(number)


ACTIONS: dict[str, Callable[[Board, Mapping[str, Any]], None]] = {
    "open": _open,
    "estimate": _estimate,
    "stop": lambda board, _: board.solver.stop(),
    "switch": lambda board, wish: board.switch(str(wish.get("name")), bool(wish.get("on"))),
    "turn": _turn,
}
"""Actions that pages ask for."""
