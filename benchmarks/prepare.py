"""An operation of a case, or a window of it, made ready on a device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from benchmarks.cases import Case
from benchmarks.inputs import INPUTS
from benchmarks.operations import Call, Operation, Slot, extents
from lfgpu.types import Array, KernelSet


@dataclass(frozen=True)
class Region:
    """Rows and columns of all images and maps."""

    rows: slice
    columns: slice

    def cut(self, values: NDArray[Any], axes: str) -> NDArray[Any]:
        """That part of an array whose axes have these letters."""
        parts = {"y": self.rows, "x": self.columns}
        return values[tuple(parts.get(axis, slice(None)) for axis in axes)]


def whole(case: Case) -> Region:
    """All of it."""
    return Region(slice(0, case.size[0]), slice(0, case.size[1]))


@dataclass(frozen=True)
class Prepared:
    """What to call, and the arrays [by name] that it reads and writes."""

    call: Call
    arrays: Mapping[str, Array]


def prepare(operation: Operation, kernels: KernelSet, device: str, case: Case, region: Region) -> Prepared:
    """Put a region of the operation's inputs on the device, allocate what it writes, and plan it."""
    lengths = extents(case)
    lengths["y"] = region.rows.stop - region.rows.start
    lengths["x"] = region.columns.stop - region.columns.start

    def placed(slot: Slot) -> Array:
        values = region.cut(INPUTS[slot.name](case), slot.axes)
        return (kernels.image if slot.axes[-1] == "c" else kernels.field)(values, device)

    def allocated(slot: Slot) -> Array:
        shape = [lengths[axis] for axis in slot.axes]
        return (kernels.zeros_image if slot.axes[-1] == "c" else kernels.zeros)(shape, device)

    arrays = {slot.name: placed(slot) for slot in operation.reads}
    arrays |= {slot.name: allocated(slot) for slot in (*operation.writes, *operation.scratch)}
    return Prepared(operation.plan(kernels, device, arrays), arrays)
