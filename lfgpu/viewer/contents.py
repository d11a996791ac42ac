"""The contents of the viewer: a light field, its maps, and the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.geometry import Geometry
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.data.views_result import ViewsResult
from lfgpu.errors import LightFieldError
from lfgpu.io import holds_map, load, read
from lfgpu.viz.figures import error_reach, scale_limits

TRUTH = "ground truth"
FINAL = "final"


@dataclass(frozen=True, eq=False)
class Entry:
    """A disparity map of the reference view, with its metadata."""

    map: DisparityMap
    result: DepthResult | None = None
    """The result that the map belongs to; None for a single map."""

    @classmethod
    def of(cls, values: DepthResult | DisparityMap) -> Entry:
        """The entry of a result or of a single map."""
        return cls(values.map, values) if isinstance(values, DepthResult) else cls(values)

    @property
    def disparity(self) -> NDArray[np.float32]:
        """The disparity map."""
        return self.map.disparity

    @property
    def confidence(self) -> NDArray[np.float32] | None:
        """The confidence; None if unknown."""
        return self.map.confidence

    def stage(self, name: str) -> NDArray[np.float32]:
        """The map after a stage; the final map for `FINAL` and for unknown stages."""
        return self.disparity if self.result is None else self.result.stages.get(name, self.disparity)


@dataclass(frozen=True, eq=False)
class Contents:
    """A light field and maps by name, in order of arrival. It is immutable: changes make a new one."""

    lf: LightField | None = None
    entries: dict[str, Entry] = field(default_factory=dict)

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
        if truth is None or truth.mask is None:
            return None if truth is None else truth.disparity
        return np.where(truth.mask, truth.disparity, np.float32(np.nan))

    def all_entries(self) -> dict[str, Entry]:
        """All maps, with the ground truth as one of them."""
        truth = None if self.lf is None else self.lf.reference_truth()
        return self.entries if truth is None else {**self.entries, TRUTH: Entry(DisparityMap(truth.disparity))}

    def with_entry(self, name: str, entry: Entry) -> Contents:
        """Add or replace a map; LightFieldError if its size is not that of the views."""
        if self.size not in (None, entry.disparity.shape):
            assert self.size is not None
            raise LightFieldError(
                f"{name} is a map of {entry.disparity.shape[1]} x {entry.disparity.shape[0]} pixels, what is shown has "
                f"{self.size[1]} x {self.size[0]}; open the light field that it belongs to."
            )
        return replace(self, entries={**self.entries, name: entry})

    def map(self, name: str, kind: str, stage: str = FINAL) -> NDArray[np.float32] | None:
        """A map of one of the kinds `frames.LOOKS`; None if there is none."""
        entry = self.all_entries().get(name)
        if entry is None:
            return None
        disparity = entry.stage(stage)
        match kind:
            case "confidence":
                return entry.confidence
            case "depth":
                return None if self.geometry is None else self.geometry.depth(disparity).astype(np.float32)
            case "error":
                return None if self.truth is None else disparity - self.truth
        return disparity

    def limits(self, kind: str) -> tuple[float, float]:
        """The scale (low, high) of a kind of maps, the same for all maps that may be compared."""
        if kind == "confidence":
            return 0.0, 1.0
        if kind == "error":
            errors = [error for name in self.entries if (error := self.map(name, kind)) is not None]
            reach = max((error_reach(error) for error in errors), default=0.07)
            return -reach, reach
        known = self.truth if self.truth is not None and kind == "disparity" else None
        maps = [known] if known is not None else [self.map(name, kind) for name in self.all_entries()]
        spans = [scale_limits(values) for values in maps if values is not None]
        return min((low for low, _ in spans), default=0.0), max((high for _, high in spans), default=1.0)

    def free_name(self, wanted: str) -> str:
        """`wanted`, with a number if that name is taken."""
        names, number = set(self.all_entries()), 2
        if wanted not in names:
            return wanted
        while f"{wanted} {number}" in names:
            number += 1
        return f"{wanted} {number}"


def opened(path: Path, into: Contents) -> Contents:
    """Open a path: a light field replaces everything in `into`, a map is added to it.

    Raises
    ------
    LightFieldError
        If the path is missing, is neither a light field nor a map, or is a map of another size.
    """
    if not path.exists():
        raise LightFieldError(f"{path} does not exist; give a light field, or what lfgpu depth wrote.")
    if not holds_map(path):
        return Contents(read(path, allow_missing=True))
    found, lf = load(path), into.lf
    if isinstance(found, ViewsResult):
        found = found.map(_shown_view(found, lf))
    if lf is not None and found.position is not None and into.position != found.position:
        lf = lf.with_reference(lf.index_of(found.position[1], found.position[0]))
    name = path.name if path.is_dir() else path.stem
    return replace(into, lf=lf).with_entry(into.free_name(name), Entry.of(found))


def _shown_view(result: ViewsResult, lf: LightField | None) -> int:
    """Which of the maps of all views is shown: that of the light field's reference view, else that of their own."""
    if lf is None:
        return result.keys[0]
    u, v = lf.positions[lf.reference_index]
    return result.index_of(v, u)


def opened_all(paths: Sequence[Path], **reading: Any) -> Contents:
    """What several paths hold together: at most one light field, and maps of it.

    Parameters
    ----------
    paths
        In any order, unless there are options for reading.
    reading
        Options of `lfgpu.read`. If there are any, the first path is read as the light field.

    Raises
    ------
    LightFieldError
        If a path is missing, or is neither a light field nor a map; if two are light fields; or if a map is of
        another size than the light field.
    """
    contents = Contents()
    if reading:
        contents = Contents(read(paths[0], **{"allow_missing": True, **reading}))
        paths = paths[1:]
    for path in sorted(paths, key=holds_map):  # False first: the light field is what maps are fitted to
        before = contents.lf
        contents = opened(path, contents)
        if before is not None and contents.lf is not None and contents.lf.views is not before.views:
            raise LightFieldError(f"{path} is a second light field; only one can be looked at, with maps of it.")
    return contents
