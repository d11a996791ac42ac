"""An operation of a case, or a window of it, made ready on a device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from benchmarks.cases import Case
from benchmarks.inputs import INPUTS
from benchmarks.operation import Desk, Operation, Slot, Work, extents
from lfgpu.contract import REDUCTION, Array, KernelSet


@dataclass(frozen=True)
class Region:
    """Rows and columns of all images and maps; what is reduced has those of the blocks in it."""

    rows: slice
    columns: slice

    def cut(self, values: NDArray[Any], axes: str) -> NDArray[Any]:
        """That part of an array whose axes have these letters."""
        parts = {"y": self.rows, "x": self.columns, "r": _reduced(self.rows), "s": _reduced(self.columns)}
        return values[tuple(parts.get(axis, slice(None)) for axis in axes)]


def _reduced(part: slice) -> slice:
    return slice(part.start // REDUCTION, part.stop // REDUCTION)


def whole(case: Case) -> Region:
    """All of it."""
    return Region(slice(0, case.size[0]), slice(0, case.size[1]))


@dataclass(frozen=True)
class Prepared:
    """What to do, and the arrays [by name] that it reads and writes."""

    work: Work
    arrays: Mapping[str, Array]

    def once(self) -> None:
        """One call from where the first one began, whatever was called before."""
        self.work.begin()
        self.work.call()


def prepare(
    operation: Operation, kernels: KernelSet, device: str, case: Case, region: Region, *, as_on: str = ""
) -> Prepared:
    """Put a region of the operation's inputs on the device, allocate what it writes, and plan it.

    Images are rounded to what they are stored as on the device `as_on`, by default the same one.
    """
    lengths = extents(case)
    for part, axis, reduced in ((region.rows, "y", "r"), (region.columns, "x", "s")):
        lengths[axis] = part.stop - part.start
        lengths[reduced] = lengths[axis] // REDUCTION
    shapes = {s.name: tuple(lengths[axis] for axis in s.axes) for s in (*operation.reads, *operation.writes)}

    def placed(slot: Slot) -> Array:
        values = region.cut(INPUTS[slot.name](case), slot.axes)
        if slot.is_image:
            return kernels.image(values.astype(slot.stored(as_on or device), copy=False), device)
        return kernels.field(values, device)

    def allocated(slot: Slot) -> Array:
        shape = shapes[slot.name]
        if slot.is_image:
            return kernels.zeros_image(shape, device, slot.stored(as_on or device).type)
        return kernels.zeros(shape, device) if shape else kernels.scalar(0.0, device)

    arrays = {slot.name: placed(slot) for slot in operation.reads if not slot.inside}
    for slot in operation.writes:
        if not slot.inside and slot.name not in arrays:
            arrays[slot.name] = allocated(slot)
    return Prepared(operation.plan(Desk(kernels, device, arrays, shapes)), arrays)
