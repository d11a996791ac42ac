"""What there is to look at: a light field, maps of it, and what they can be compared with."""

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
    """One disparity map of the reference view, and what is known about it."""

    map: DisparityMap
    result: DepthResult | None = None
    """The result that it is of; None for a map by itself."""

    @classmethod
    def of(cls, values: DepthResult | DisparityMap) -> Entry:
        """The entry of a result or of a map by itself."""
        return cls(values.map, values) if isinstance(values, DepthResult) else cls(values)

    @property
    def disparity(self) -> NDArray[np.float32]:
        """The map itself."""
        return self.map.disparity

    @property
    def confidence(self) -> NDArray[np.float32] | None:
        """How far to trust it; None if that is not known."""
        return self.map.confidence

    def stage(self, name: str) -> NDArray[np.float32]:
        """The map after a stage; `FINAL`, and a stage that there is not, is the map itself."""
        return self.disparity if self.result is None else self.result.stages.get(name, self.disparity)


@dataclass(frozen=True, eq=False)
class Contents:
    """A light field and maps by name, in the order in which they came; never changed, only replaced."""

    lf: LightField | None = None
    entries: dict[str, Entry] = field(default_factory=dict)

    @property
    def size(self) -> tuple[int, int] | None:
        """(height, width) of the maps, None if there is nothing."""
        if self.lf is not None:
            return self.lf.size
        for entry in self.entries.values():
            return entry.disparity.shape[0], entry.disparity.shape[1]
        return None

    @property
    def geometry(self) -> Geometry | None:
        """What turns disparity into metres: the light field says it, or else the first of the maps that does."""
        if self.lf is not None and self.lf.geometry is not None:
            return self.lf.geometry
        known = (entry.map.geometry for entry in self.entries.values())
        return next((geometry for geometry in known if geometry is not None), None)

    @property
    def position(self) -> tuple[float, float] | None:
        """(u, v) of the view that the maps belong to; None if that is not known."""
        if self.lf is not None:
            u, v = self.lf.positions[self.lf.reference_index]
            return float(u), float(v)
        known = (entry.map.position for entry in self.entries.values())
        return next((position for position in known if position is not None), None)

    @property
    def truth(self) -> NDArray[np.float32] | None:
        """The true disparity of the reference view, NaN where it is not scored."""
        truth = None if self.lf is None else self.lf.reference_truth()
        if truth is None or truth.mask is None:
            return None if truth is None else truth.disparity
        return np.where(truth.mask, truth.disparity, np.float32(np.nan))

    def all_entries(self) -> dict[str, Entry]:
        """The maps, and the truth as one of them."""
        truth = None if self.lf is None else self.lf.reference_truth()
        return self.entries if truth is None else {**self.entries, TRUTH: Entry(DisparityMap(truth.disparity))}

    def with_entry(self, name: str, entry: Entry) -> Contents:
        """One map more, or another one of that name; LightFieldError if it is of another size than the views."""
        if self.size not in (None, entry.disparity.shape):
            assert self.size is not None
            raise LightFieldError(
                f"{name} is a map of {entry.disparity.shape[1]} x {entry.disparity.shape[0]} pixels, what is shown has "
                f"{self.size[1]} x {self.size[0]}; open the light field that it belongs to."
            )
        return replace(self, entries={**self.entries, name: entry})

    def map(self, name: str, kind: str, stage: str = FINAL) -> NDArray[np.float32] | None:
        """A map of one of the `frames.LOOKS`; None where there is no such thing."""
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
        """The scale of all maps of a kind: the same for all that may be compared."""
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
        """`wanted`, or with a number if there is a map of that name."""
        names, number = set(self.all_entries()), 2
        if wanted not in names:
            return wanted
        while f"{wanted} {number}" in names:
            number += 1
        return f"{wanted} {number}"


def opened(path: Path, into: Contents) -> Contents:
    """What a path holds, added to what is there: a light field replaces all, a map of it joins the others.

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
    """Of maps of all views, that of the light field's reference view; without a light field that of their own."""
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
