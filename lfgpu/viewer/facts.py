"""Facts that pages are told of the state of a viewer, as plain values for JSON, without anything of the web."""

import dataclasses
import math
import threading
from functools import cache
from time import perf_counter
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from lfgpu.config import parameters, value_of
from lfgpu.data import LightField
from lfgpu.data.summary import are_counted
from lfgpu.io import MAP_FORMATS
from lfgpu.methods import METHODS, PRESETS, nearest_preset
from lfgpu.metrics import Metrics
from lfgpu.viewer.board import Board
from lfgpu.viewer.contents import LIVE, QUANTITIES, TRUTH, Contents, Entry
from lfgpu.viewer.pictures import wire_type
from lfgpu.viz.colours import shades

COLOURS = ("viridis", "cividis", "magma", "turbo", "gray", "RdBu_r", "viridis_r")
"""Colour maps of matplotlib that pages may choose."""

_MOST = 50.0  # per cent of the pixels: a map of more bad ones is not shown without a word
_DARK = 0.45  # of full intensity: a light field with hardly anything brighter is shown brighter
_SCALE_AGE = 1.0  # seconds after which the scales of a stream are measured again


class Facts:
    """The facts of a board, computed when they are asked for and something has changed.

    Contents have a number, their revision. A page asks for pictures of the revision that it was told, so that all of
    them are of one frame of a stream. Who has told a page of a revision keeps its contents, else they are forgotten.
    """

    def __init__(self, board: Board) -> None:
        self._board, self._lock = board, threading.Lock()
        self._of: Contents | None = None
        self._contents: dict[str, Any] = {}
        self._scales: dict[str, Any] = {}
        self._measured = -math.inf
        self._views, self._revision = 0, 0
        self._told = WeakValueDictionary[int, Contents]()

    def now(self) -> dict[str, Any]:
        """Return the state as plain values. May be called from any thread."""
        return self.newest()[0]

    def newest(self) -> tuple[dict[str, Any], Contents]:
        """Return the state as plain values, and the contents that it is of. May be called from any thread."""
        with self._lock:
            contents = self._board.contents
            state = self._now(contents)
            self._told[state["revision"]] = contents
            return state, contents

    def contents(self, revision: int) -> Contents | None:
        """Return the contents of a revision; None if they are forgotten."""
        return self._told.get(revision)

    def _now(self, contents: Contents) -> dict[str, Any]:
        board = self._board
        if contents is not self._of:
            self._revision += 1
            live = self._of is not None and contents.frame + self._of.frame > 0 and contents.frame != self._of.frame
            film, before = contents.film, None if self._of is None else self._of.film
            if film is not None and before is not None and film.path == before.path:
                self._scales = {
                    kind: {**found, "limits": self._scales.get(kind, found)["limits"]}
                    for kind, found in _scales(contents).items()
                }
            elif not live or perf_counter() - self._measured > _SCALE_AGE:
                self._scales = _scales(contents, self._scales if live else {})
                self._measured = perf_counter()
            if self._of is None or contents.lf is not self._of.lf:
                self._views += 1
            self._contents, self._of = _facts(contents), contents
        progress, loading, stream = board.solver.progress, board.loading, board.stream
        measured = {name: _number(getattr(stream, name)) for name in ("rate", "latency")}
        return {
            **self._contents,
            "revision": self._revision,
            "views": self._views,
            "scales": self._scales,
            "newest": board.newest,
            "loading": None if loading is None else {"text": loading[0], "seconds": perf_counter() - loading[1]},
            "progress": dataclasses.asdict(progress),
            "stream": {**dataclasses.asdict(stream), **measured, "switches": list(board.switches)},
        }


def still(contents: Contents) -> dict[str, Any]:
    """Return the state of contents that do not change, as `Facts.now` does, without stages and estimates."""
    board = Board()
    board.replace(contents)
    state = Facts(board).now()
    return {**state, "film": None, "results": [{**result, "stages": []} for result in state["results"]]}


@cache
def fixed() -> dict[str, Any]:
    """Return the facts that never change: presets with their parameters, colour maps, quantities, file formats."""
    return {
        "presets": [
            {
                "name": name,
                "method": config.method,
                "about": METHODS[config.method].labels[name],
                "sections": _sections(config),
            }
            for name, config in PRESETS.items()
        ],
        "colours": {name: shades(name, 256).ravel().tolist() for name in COLOURS},
        "quantities": {name: dataclasses.asdict(quantity) for name, quantity in QUANTITIES.items()},
        "formats": [
            {"suffix": entry.suffixes[0], "about": entry.description}
            for entry in MAP_FORMATS
            if entry.write is not None and entry.is_available
        ],
        "live": LIVE,
    }


def _sections(config: Any) -> list[dict[str, Any]]:
    sections: dict[str, list[dict[str, Any]]] = {}
    for name, field in parameters(config):
        section, parameter = name.split(".")
        meta = field.metadata
        sections.setdefault(section, []).append(
            {
                "name": parameter,
                "value": value_of(config, name),
                "about": meta["doc"],
                "choices": list(meta["choices"]) if "choices" in meta else None,
                "low": meta.get("low"),
                "high": meta.get("high"),
                "whole": isinstance(field.default, int),
            }
        )
    return [{"name": section, "parameters": found} for section, found in sections.items()]


def _facts(contents: Contents) -> dict[str, Any]:
    return {
        "lightField": None if contents.lf is None else _light_field(contents.lf),
        "size": contents.size,
        "metric": contents.geometry is not None,
        "results": [_result(contents, name, entry) for name, entry in contents.all_entries().items()],
        "frame": contents.frame,
        "film": None if contents.film is None else list(contents.film.frames),
    }


def _light_field(lf: LightField) -> dict[str, Any]:
    return {
        "name": lf.name,
        "views": len(lf.views),
        "bits": 8 * np.dtype(wire_type(lf)).itemsize,
        "stored": str(lf.views.dtype),
        "channels": lf.channels,
        "reference": lf.reference_index,
        "positions": lf.positions.tolist(),
        "offsets": lf.offsets.tolist(),
        "grid": lf.grid_shape,
        "row": lf.row().tolist(),
        "column": lf.column().tolist(),
        "counted": are_counted(lf.positions),
        "read": [f"{label.capitalize()}: {sentence}." for label, sentence in lf.reading.lines()],
        "findings": list(lf.notes),
        "exposure": _exposure(lf),
        "aperture": float(np.hypot(*lf.offsets.T).max()),
    }


def _exposure(lf: LightField) -> float:
    """Find by how many stops a dark light field is shown brighter: until 1 % of the reference is almost white."""
    few = lf.views[lf.reference_index, ::4, ::4].max(axis=-1)
    bright = float(np.quantile(few, 0.99)) * lf.scale
    return round(min(math.log2(0.9 / max(bright, 1e-3)), 6.0), 1) if bright < _DARK else 0.0


def _result(contents: Contents, name: str, entry: Entry) -> dict[str, Any]:
    scores, result = contents.scores(name), entry.result
    about = ""
    if result is not None:
        took = "" if result.seconds is None else f", {result.seconds:.2g} s"
        preset, differs = nearest_preset(result.config)
        preset += ", changed" if differs else ""
        run = f"Preset {preset}; {result.backend} on {result.device}{took}. {result.status}"
        about = run if result.converged else f"{run} Not converged: more iterations may improve the map."
    return {
        "name": name,
        "isTruth": name == TRUTH and name not in contents.entries,
        "kinds": list(contents.kinds(name)),
        "stages": [] if result is None else list(result.disparity_stages)[:-1],
        "identity": entry.serial,
        "earlier": entry.frame is not None and entry.frame != contents.frame and name != TRUTH,
        "about": about,
        "findings": _findings(entry, scores),
        "scores": None
        if scores is None
        else {
            "mse": _number(scores.mse_100),
            "bad07": _number(scores.badpix_07),
            "bad03": _number(scores.badpix_03),
            "bad01": _number(scores.badpix_01),
            "q25": _number(scores.q25),
        },
    }


def _findings(entry: Entry, scores: Metrics | None) -> list[str]:
    """Say what may be wrong with a map: what its estimate found, and that most of its pixels are bad."""
    found = [] if entry.result is None else [*entry.result.remarks, *entry.result.notes]
    known = np.isfinite(entry.disparity)
    if scores is not None and scores.badpix_07 > _MOST:
        found.append(f"{scores.badpix_07:.0f} % of the map is more than 0.07 px off the ground truth.")
    elif scores is None and entry.confidence is not None and known.any():
        unsure = 100 * float((entry.confidence[known] < 0.5).mean())
        if unsure > _MOST:
            found.append(f"The confidence is below 0.5 at {unsure:.0f} % of the map.")
    return found


def _scales(contents: Contents, before: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the ends of the common scale of each quantity that there is, and its smallest and largest value.

    Scales of a stream hold those `before` as well: a colour keeps its meaning from frame to frame.
    """
    found = {}
    for kind in QUANTITIES:
        extent = contents.extent(kind)
        if extent is not None:
            ends = [contents.limits(kind), *([before[kind]["limits"]] if before and kind in before else [])]
            found[kind] = {"limits": (min(low for low, _ in ends), max(high for _, high in ends)), "extent": extent}
    return found


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
