"""The contents of the viewer: a light field, its maps, and the ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any, Self
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import DepthResult, DisparityMap, Geometry, GroundTruth, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import holds_map, load, one_map, read, recognise
from lfgpu.io.formats import chosen_format
from lfgpu.metrics import Metrics, evaluate
from lfgpu.viewer.film import Film, holds_maps_of_frames
from lfgpu.viz.colours import LOOKS
from lfgpu.viz.scales import ERRORS, scale_limits

TRUTH = "ground truth"
"""The name of the ground truth among the maps."""

LIVE = "live"
"""The name of the newest map of a stream among the maps."""

FINAL = "final"
"""The name of the map after the last stage."""


QUANTITIES = {kind: LOOKS[kind] for kind in ("disparity", "depth", "confidence", "uncertainty", "error")}
"""The quantities of maps by name, and how they are shown at first."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A disparity map of the reference view, with its metadata."""

    map: DisparityMap
    result: DepthResult | None = None  # the result that the map belongs to; None for a single map
    frame: int | None = 0  # number of the frame of a stream that it belongs to, as `Contents.frame`; None if unknown
    serial: int = field(default_factory=count().__next__, kw_only=True)
    """A number that no other entry of this process has."""
    _ends: dict[str, tuple[float, float]] = field(default_factory=dict, kw_only=True, repr=False)

    @classmethod
    def of(cls, values: DepthResult | DisparityMap, frame: int | None = 0) -> Self:
        """Return the entry of a result or of a single map."""
        return cls(values.map, values, frame) if isinstance(values, DepthResult) else cls(values, None, frame)

    @property
    def disparity(self) -> NDArray[np.float32]:
        """The disparity map."""
        return self.map.disparity

    @property
    def confidence(self) -> NDArray[np.float32] | None:
        """The confidence; None if unknown."""
        return self.map.confidence

    def stage(self, name: str) -> NDArray[np.float32]:
        """Return the map after a stage; the final map for `FINAL` and for unknown stages."""
        return self.disparity if self.result is None else self.result.stages.get(name, self.disparity)

    def ends(self, stage: str) -> tuple[float, float]:
        """Return the smallest and the largest disparity after a stage; (0, 0) if it is undefined everywhere."""
        if stage not in self._ends:
            values = self.stage(stage)
            known = values[np.isfinite(values)]
            self._ends[stage] = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        return self._ends[stage]


def _scored(entry: Entry, truth: GroundTruth) -> Metrics | None:
    try:
        return evaluate(entry.disparity, truth)
    except LightFieldError:  # smaller than the border that is not scored
        return None


_scores = WeakKeyDictionary[Entry, tuple[GroundTruth, Metrics | None]]()  # and the truth that they are against
_truths = WeakKeyDictionary[GroundTruth, Entry]()  # one entry each, with one serial number


@dataclass(frozen=True, eq=False)
class Contents:
    """A light field and maps by name, in order of arrival. It is immutable: changes make a new one."""

    lf: LightField | None = None
    entries: dict[str, Entry] = field(default_factory=dict)
    frame: int = 0
    """Number of the frame of a stream or a film whose views are shown; 0 before the first one of a stream."""
    film: Film | None = None  # the film that the light field is a frame of; None if it is none

    @property
    def size(self) -> tuple[int, int] | None:
        """(height, width) of the maps; None if empty."""
        if self.lf is not None:
            return self.lf.size
        for entry in self.entries.values():
            return entry.disparity.shape[0], entry.disparity.shape[1]
        return None

    @property
    def geometry(self) -> Geometry | None:
        """The camera geometry: that of the light field, else that of the first map that has one."""
        if self.lf is not None and self.lf.geometry is not None:
            return self.lf.geometry
        known = (entry.map.geometry for entry in self.entries.values())
        return next((geometry for geometry in known if geometry is not None), None)

    @property
    def position(self) -> tuple[float, float] | None:
        """(u, v) of the view that the maps belong to; None if unknown."""
        if self.lf is not None:
            u, v = self.lf.positions[self.lf.reference_index]
            return float(u), float(v)
        known = (entry.map.position for entry in self.entries.values())
        return next((position for position in known if position is not None), None)

    @property
    def truth(self) -> NDArray[np.float32] | None:
        """The true disparity of the reference view; NaN where it is not scored. None if unknown."""
        truth = None if self.lf is None else self.lf.reference_truth()
        return None if truth is None else truth.scored

    def all_entries(self) -> dict[str, Entry]:
        """Return all maps, with the ground truth as one of them."""
        truth = None if self.lf is None else self.lf.reference_truth()
        if truth is None:
            return self.entries
        if truth not in _truths:
            _truths[truth] = Entry(DisparityMap(truth.disparity))
        return {**self.entries, TRUTH: _truths[truth]}

    def with_entry(self, name: str, entry: Entry) -> Self:
        """Add or replace a map; LightFieldError if its size is not that of the views."""
        if self.size not in (None, entry.disparity.shape):
            assert self.size is not None
            raise LightFieldError(
                f"{name} is a map of {entry.disparity.shape[1]} x {entry.disparity.shape[0]} pixels, what is shown has "
                f"{self.size[1]} x {self.size[0]}; open the light field that it belongs to."
            )
        return replace(self, entries={**self.entries, name: entry})

    def map(self, name: str, kind: str, stage: str = FINAL, where: Any = ...) -> NDArray[np.float32] | None:
        """Return a map of one of the `QUANTITIES`, or what `where` chooses of it; None if there is none."""
        entry = self.all_entries().get(name)
        if entry is None or kind not in self.kinds(name):
            return None
        known = {"confidence": entry.confidence, "uncertainty": entry.map.uncertainty}.get(kind)
        values = (entry.stage(stage) if known is None else known)[where]
        if kind == "depth" and self.geometry is not None:
            return self.geometry.depth(values).astype(np.float32)
        return values - self.truth[where] if kind == "error" and self.truth is not None else values

    def kinds(self, name: str) -> tuple[str, ...]:
        """Return the quantities that a map has."""
        entry = self.all_entries()[name]
        missing = {
            "depth": self.geometry is None,
            "confidence": entry.confidence is None,
            "uncertainty": entry.map.uncertainty is None,
            "error": not self.is_scored(name),
        }
        return tuple(kind for kind in QUANTITIES if not missing.get(kind, False))

    def is_scored(self, name: str) -> bool:
        """Tell whether the truth belongs to the same frame as a map."""
        return self.truth is not None and name in self.entries and self.entries[name].frame == self.frame

    def scores(self, name: str) -> Metrics | None:
        """Return the scores of a map; None without a truth of its frame, or where nothing can be scored."""
        truth = None if self.lf is None else self.lf.reference_truth()
        if truth is None or not self.is_scored(name):
            return None
        entry = self.entries[name]
        if entry not in _scores or _scores[entry][0] is not truth:
            _scores[entry] = truth, _scored(entry, truth)
        return _scores[entry][1]

    def limits(self, kind: str) -> tuple[float, float]:
        """Return the scale (low, high) of a quantity, the same for all maps that may be compared."""
        if kind == "confidence":
            return 0.0, 1.0
        if kind == "error":
            return ERRORS
        known = self.truth if self.truth is not None and kind == "disparity" else None
        maps = [known] if known is not None else [self.map(name, kind) for name in self.all_entries()]
        spans = [scale_limits(values) for values in maps if values is not None and np.isfinite(values).any()]
        return min((low for low, _ in spans), default=0.0), max((high for _, high in spans), default=1.0)

    def extent(self, kind: str) -> tuple[float, float] | None:
        """Return the smallest and the largest value of a quantity over all maps; None if there is none."""
        maps = [values for name in self.all_entries() if (values := self.map(name, kind)) is not None]
        ends = [(defined.min(), defined.max()) for v in maps if (defined := v[np.isfinite(v)]).size]
        return (float(min(low for low, _ in ends)), float(max(high for _, high in ends))) if ends else None

    def with_frame(self, entry: Entry, views: NDArray[Any] | None) -> Self:
        """Take the newest frame of a stream: its map, and its views if they are given; LightFieldError if sizes differ.

        The truth goes with the views that it belongs to. A map without its views belongs to an unknown frame.
        """
        if views is None or self.lf is None:
            return self.with_entry(LIVE, replace(entry, frame=None))
        if views.shape != self.lf.views.shape or views.dtype != self.lf.views.dtype:
            raise LightFieldError(
                f"views must be {self.lf.views.dtype} {self.lf.views.shape} as those that are shown, "
                f"found {views.dtype} {views.shape}."
            )
        frame = self.frame + 1
        newer = replace(self, lf=replace(self.lf, views=views, truth=None), frame=frame)
        return newer.with_entry(LIVE, replace(entry, frame=frame))

    def turned(self, number: int) -> Self:
        """Return another frame of the film, with its map if there is one; LightFieldError if it is none of them."""
        film = self.film
        if film is None:
            raise LightFieldError("what is shown is no film: it has no other frames.")
        lf = film.light_field(number)
        if self.lf is not None and lf.size != self.lf.size:
            raise LightFieldError(f"{film.frames[number]} has views of another size than the other frames.")
        entries = dict(self.entries)
        if film.maps is not None:
            found, name = film.map(number, lf), film.maps.path.name
            entries.pop(name, None)
            if found is not None:
                entries = {name: Entry.of(found, number), **entries}
        contents = replace(self, lf=lf, frame=number, entries={})
        for name, entry in entries.items():
            contents = contents.with_entry(name, entry)
        return contents

    def free_name(self, wanted: str) -> str:
        """Return `wanted`, with a number if that name is taken."""
        names, number = set(self.all_entries()), 2
        if wanted not in names:
            return wanted
        while f"{wanted} {number}" in names:
            number += 1
        return f"{wanted} {number}"


def opened(path: Path, into: Contents) -> Contents:
    """Open a path: a light field replaces everything in `into`, a map of its size is added to it."""
    if not path.exists():
        raise LightFieldError(f"{path} does not exist; give a light field, or what lfgpu depth wrote.")
    if holds_maps_of_frames(path):
        if into.film is None:
            raise LightFieldError(f"{path} holds maps of many frames; give the folder of the recorded frames, too.")
        return replace(into, film=into.film.with_maps(path, into.frame)).turned(into.frame)
    if (film := Film.of(path)) is not None:
        return Contents(film=film).turned(next(iter(film.frames)))
    if not holds_map(path):
        return Contents(read(path, allow_missing=True))
    lf = into.lf
    found = one_map(load(path), None if lf is None else lf.positions[lf.reference_index])
    if lf is not None and found.position is not None and into.position != found.position:
        lf = lf.with_reference(lf.index_of(found.position[1], found.position[0]))
    name = path.name if path.is_dir() else path.stem
    return replace(into, lf=lf).with_entry(into.free_name(name), Entry.of(found))


def _is_map(path: Path) -> bool:
    return holds_maps_of_frames(path) or holds_map(path)


def check_known(paths: Sequence[Path], **reading: Any) -> None:
    """Look at paths without reading them; raise LightFieldError if `opened_all` cannot open one."""
    if reading:
        chosen_format(paths[0], reading.get("format"), reading.get("pattern"))
    for path in paths[1:] if reading else paths:
        if not _is_map(path) and Film.of(path) is None:
            recognise(path)


def opened_all(paths: Sequence[Path], **reading: Any) -> Contents:
    """Open several paths together: at most one light field, and maps of its size.

    If there are options of `lfgpu.read` in `reading`, the first path is read as the light field.
    """
    contents = Contents()
    if reading:
        contents = Contents(read(paths[0], **{"allow_missing": True, **reading}))
        paths = paths[1:]
    for path in sorted(paths, key=_is_map):  # False first: the light field is what maps are fitted to
        before = contents.lf
        contents = opened(path, contents)
        if before is not None and not _is_map(path):
            raise LightFieldError(f"{path} is a second light field; only one can be looked at, with maps of it.")
    return contents
