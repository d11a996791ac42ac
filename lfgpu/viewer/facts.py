"""What pages are told of the state of a viewer, as plain values for JSON. It knows nothing of the web."""

from __future__ import annotations

import dataclasses
import math
import threading
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np

from lfgpu.config import parameters
from lfgpu.data.lightfield import LightField
from lfgpu.io import MAP_FORMATS
from lfgpu.methods import METHODS, PRESETS
from lfgpu.viewer.board import Board
from lfgpu.viewer.contents import LIVE, QUANTITIES, TRUTH, Contents, Entry
from lfgpu.viewer.pictures import wire_type

COLOURS = ("viridis", "cividis", "magma", "turbo", "gray", "RdBu_r", "viridis_r")
"""Colour maps of matplotlib that pages may choose."""

_SCALE_AGE = 1.0  # seconds after which the scales of a stream are measured again
_WRITTEN = (".npz", ".pfm", ".exr", ".ply", ".png", ".tif")


class Facts:
    """The facts of a board, computed when they are asked for and something has changed."""

    def __init__(self, board: Board) -> None:
        self._board, self._lock = board, threading.Lock()
        self._of: Contents | None = None
        self._contents: dict[str, Any] = {}
        self._scales: dict[str, Any] = {}
        self._measured = -math.inf
        self._views, self._revision = 0, 0

    def now(self) -> dict[str, Any]:
        """The state as plain values. May be called from any thread."""
        with self._lock:
            return self._now()

    def _now(self) -> dict[str, Any]:
        board, contents = self._board, self._board.contents
        if contents is not self._of:
            self._revision += 1
            live = self._of is not None and contents.frame + self._of.frame > 0 and contents.frame != self._of.frame
            if not live or perf_counter() - self._measured > _SCALE_AGE:
                self._scales, self._measured = _scales(contents), perf_counter()
            if self._of is None or contents.lf is not self._of.lf:
                self._views += 1
            self._contents, self._of = _facts(contents), contents
        progress, loading, stream = board.solver.progress, board.loading, board.stream
        return {
            **self._contents,
            "revision": self._revision,
            "views": self._views,
            "scales": self._scales,
            "newest": board.newest,
            "loading": None if loading is None else {"text": loading[0], "seconds": perf_counter() - loading[1]},
            "progress": dataclasses.asdict(progress),
            "stream": {**dataclasses.asdict(stream), "switches": list(board.switches)},
        }


@cache
def fixed() -> dict[str, Any]:
    """What never changes: presets with their parameters, colour maps, quantities, file formats."""
    from matplotlib import colormaps

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
        "colours": {
            name: (colormaps[name](np.linspace(0, 1, 256))[:, :3] * 255 + 0.5).astype(int).ravel().tolist()
            for name in COLOURS
        },
        "quantities": {name: dataclasses.asdict(quantity) for name, quantity in QUANTITIES.items()},
        "formats": [
            {"suffix": suffix, "about": entry.description}
            for suffix in _WRITTEN
            for entry in MAP_FORMATS
            if suffix in entry.suffixes and entry.write is not None and entry.is_available
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
                "value": getattr(getattr(config, section), parameter),
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
        "lightField": None if contents.lf is None else _light_field(contents.lf, contents),
        "size": contents.size,
        "metric": contents.geometry is not None,
        "results": [_result(contents, name, entry) for name, entry in contents.all_entries().items()],
        "frame": contents.frame,
    }


def _light_field(lf: LightField, contents: Contents) -> dict[str, Any]:
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
        "notes": list(lf.notes),
        "aperture": float(np.hypot(*lf.offsets.T).max()),
    }


def _result(contents: Contents, name: str, entry: Entry) -> dict[str, Any]:
    scores, result = contents.scores(name), entry.result
    about = ""
    if result is not None:
        seconds = result.timings.get("total")
        took = "" if seconds is None else f", {seconds:.2g} s"
        about = f"{result.config.method} with {result.backend} on {result.device}{took}. {result.status}"
    return {
        "name": name,
        "isTruth": name == TRUTH and name not in contents.entries,
        "kinds": list(contents.kinds(name)),
        "stages": [] if result is None else list(result.disparity_stages)[:-1],
        "identity": entry.serial,
        "earlier": entry.frame is not None and entry.frame != contents.frame and name != TRUTH,
        "about": about,
        "scores": None
        if scores is None
        else {
            "mse": _number(scores.mse_100),
            "bad07": _number(scores.badpix_07),
            "bad01": _number(scores.badpix_01),
            "q25": _number(scores.q25),
        },
    }


def _scales(contents: Contents) -> dict[str, Any]:
    """For each quantity that there is: the ends of its common scale, and its smallest and largest value."""
    found = {}
    for kind in QUANTITIES:
        extent = contents.extent(kind)
        if extent is not None:
            found[kind] = {"limits": contents.limits(kind), "extent": extent}
    return found


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
