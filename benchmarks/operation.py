"""What an operation is: the arrays that it reads and writes, how it is planned, and what it has to move."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.cases import CHANNELS, Case
from benchmarks.inputs import CONFIG, MATCHING, line_offsets, sweep_labels
from lfgpu.contract import REDUCTION, Array, KernelSet, half_window
from lfgpu.methods.structure_tensor import structure_filters

PAIRS = 10
"""Pairs that the method's L-BFGS remembers."""
_TOLERANCE = 1e-4  # relative error of operations in float32, at any size
_HALF_STEP = 2.0**-11  # half a step of float16, relative


def _nothing() -> None:
    pass


@dataclass(frozen=True)
class Work:
    """What is timed, and where it remembers something what brings it back to its first call."""

    call: Callable[[], None]
    begin: Callable[[], None] = _nothing


@dataclass(frozen=True)
class Desk:
    """A backend, a device, and by name the arrays there and their shapes."""

    kernels: KernelSet
    device: str
    arrays: Mapping[str, Array]
    shapes: Mapping[str, tuple[int, ...]]


Plan = Callable[[Desk], Work]
"""From what lies ready to what is timed; what is planned once is planned here."""


@dataclass(frozen=True)
class Slot:
    """An array: its name, a letter for each axis (see `extents`), and what an element is on the device.

    Arrays whose last axis is c are images, others are fields; what has no axes is a number.
    """

    name: str
    axes: str
    dtype: str = "float32"
    on_gpu: str = ""
    """What an element is on a GPU, if not `dtype`."""
    inside: bool = False
    """Whether it is a part of what was planned, that nobody else sees."""

    def __str__(self) -> str:
        if not self.axes:
            return f"{self.name} (a number)"
        kinds = [self.dtype] if self.dtype != "float32" else []
        kinds += [f"{self.on_gpu} on a GPU"] if self.on_gpu else []
        return " ".join([f"{self.name}[{','.join(self.axes)}]", *kinds])

    @property
    def is_image(self) -> bool:
        """Whether it has channels."""
        return self.axes.endswith("c")

    def stored(self, device: str) -> np.dtype[np.generic]:
        """What an element is on that device."""
        return np.dtype(self.on_gpu if self.on_gpu and device != "cpu" else self.dtype)


@dataclass(frozen=True)
class Operation:
    """One operation of the contract."""

    name: str
    reads: tuple[Slot, ...]
    writes: tuple[Slot, ...]
    plan: Plan
    local: bool = True
    """What it writes at a pixel depends on its surroundings alone, so that a window of it can be checked."""
    mask: bool = False
    """What it writes is 0 or 1."""
    trusted: tuple[str, float] | None = None
    """(array, least value): the other arrays mean something only where this one is at least that."""

    def traffic(self, case: Case, device: str) -> int:
        """Compulsory bytes: each array that is read once, each array that is written once, nothing twice."""
        return sum(size(slot, case) * slot.stored(device).itemsize for slot in (*self.reads, *self.writes))

    def tolerance(self, device: str) -> float:
        """The relative error above which something is wrong; what is written as float16 is rounded in any case."""
        half = any(slot.stored(device) == np.float16 for slot in self.writes)
        return _TOLERANCE + (_HALF_STEP if half else 0.0)

    @property
    def formula(self) -> str:
        """What `traffic` adds up, in words."""
        return f"{' + '.join(map(str, self.reads))} → {' + '.join(map(str, self.writes))}"


def extents(case: Case) -> dict[str, int]:
    """How long each axis is: n views, u views of the reference's row that are used, y, x, c, k neighbours, m pairs.

    Of matching: l labels, p neighbours on a surface, w neighbours over which costs are averaged, r rows and s columns
    of a reduced view.
    """
    filters = structure_filters(line_offsets(case).astype(np.float64), CONFIG.local)
    return {
        "n": case.grid[0] * case.grid[1],
        "u": int((filters.along_value != 0).any(0).sum()),
        "y": case.size[0],
        "x": case.size[1],
        "c": CHANNELS,
        "k": len(half_window(CONFIG.prior.window)),
        "l": sweep_labels(case)[2],
        "m": PAIRS,
        "p": len(half_window(MATCHING.prior.window)),
        "r": case.size[0] // REDUCTION,
        "s": case.size[1] // REDUCTION,
        "w": len(half_window(MATCHING.semi_global.window)),
        "2": 2,
    }


def size(slot: Slot, case: Case) -> int:
    """Elements of an array."""
    lengths = extents(case)
    return math.prod(lengths[axis] for axis in slot.axes)
