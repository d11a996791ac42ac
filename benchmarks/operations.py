"""The operations, as data: which arrays each reads and writes, and how it is called through the kernel contract."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.cases import CHANNELS, Case
from benchmarks.errors import BenchmarkError
from benchmarks.inputs import BYTE, CONFIG, INPUTS, line_offsets
from lfgpu.initial import structure_filters
from lfgpu.types import Array, KernelSet, StructureFilters, half_window

Arrays = Mapping[str, Array]
Call = Callable[[], float | None]
Plan = Callable[[KernelSet, str, Arrays], Call]
"""From a backend, a device and the arrays by name to what is timed; what is planned once is planned here."""


@dataclass(frozen=True)
class Slot:
    """An array: its name, a letter for each axis (see `extents`), and what an element is on the device.

    Arrays whose last axis is c are images, others are fields.
    """

    name: str
    axes: str
    dtype: str = "float32"

    def __str__(self) -> str:
        return f"{self.name}[{','.join(self.axes)}]" + (f" {self.dtype}" if self.dtype != "float32" else "")


@dataclass(frozen=True)
class Operation:
    """One operation of the contract."""

    name: str
    reads: tuple[Slot, ...]
    writes: tuple[Slot, ...]
    plan: Plan
    scratch: tuple[Slot, ...] = ()
    """Arrays that it may use but that nobody needs: they do not count as traffic."""
    local: bool = True
    """What it writes at a pixel depends on its surroundings alone, so that a window of it can be checked."""
    trusted: tuple[str, float] | None = None
    """(array, least value): the other arrays mean something only where this one is at least that."""

    def traffic(self, case: Case) -> int:
        """Compulsory bytes: each array that is read once, each array that is written once, nothing twice."""
        return sum(size(slot, case) * np.dtype(slot.dtype).itemsize for slot in (*self.reads, *self.writes))

    @property
    def formula(self) -> str:
        """What `traffic` adds up, in words."""
        writes = " + ".join(map(str, self.writes)) or "a number"
        return f"{' + '.join(map(str, self.reads))} → {writes}"


def extents(case: Case) -> dict[str, int]:
    """How long each axis is: n views but the reference, u views of its row that are used, y, x, c, k neighbours."""
    filters = structure_filters(line_offsets(case).astype(np.float64), CONFIG.local)
    return {
        "n": case.grid[0] * case.grid[1] - 1,
        "u": int((filters.along_value != 0).any(0).sum()),
        "y": case.size[0],
        "x": case.size[1],
        "c": CHANNELS,
        "k": len(half_window(CONFIG.prior.window)),
        "2": 2,
    }


def size(slot: Slot, case: Case) -> int:
    """Elements of an array."""
    lengths = extents(case)
    return math.prod(lengths[axis] for axis in slot.axes)


def find(name: str) -> Operation:
    """The operation of that name; BenchmarkError if there is none."""
    for operation in OPERATIONS:
        if operation.name == name:
            return operation
    raise BenchmarkError(f"unknown operation {name!r}; there are {', '.join(o.name for o in OPERATIONS)}.")


# --- how each is called ---


def _data_term(k: KernelSet, _: str, a: Arrays) -> Call:
    softness = CONFIG.refinement.softness
    term = k.data_term(a["image"], a["recorded"], a["valid"], a["offsets"], scale=1.0, softness=softness)
    return lambda: term(a["disparity"], a["gradient"])


def _splat(k: KernelSet, _: str, a: Arrays) -> Call:
    return lambda: k.splat(
        a["image"],
        a["disparity"],
        a["offsets"],
        softness=CONFIG.refinement.softness,
        views_out=a["views"],
        coverage_out=a["coverage"],
    )


def _splat_vjp(k: KernelSet, _: str, a: Arrays) -> Call:
    return lambda: k.splat_vjp(
        a["image"],
        a["disparity"],
        a["residual"],
        a["offsets"],
        softness=CONFIG.refinement.softness,
        gradient_out=a["gradient"],
    )


def _splat_transpose(k: KernelSet, _: str, a: Arrays) -> Call:
    softness = CONFIG.refinement.softness
    return lambda: k.splat_transpose(
        a["residual"], a["disparity"], a["offsets"], softness=softness, image_out=a["image_out"]
    )


def _nlm_weights(k: KernelSet, _: str, a: Arrays) -> Call:
    prior = CONFIG.prior
    return lambda: k.nlm_weights(
        a["image"],
        window=prior.window,
        patch=prior.patch,
        sigma_color=prior.sigma_color,
        sigma_gradient=prior.sigma_gradient,
        floor=prior.floor,
        scratch_out=a["scratch"],
        weights_out=a["weights_out"],
    )


def _nlm_laplacian(k: KernelSet, _: str, a: Arrays) -> Call:
    return lambda: k.nlm_laplacian(
        a["weights"], a["disparity"], window=CONFIG.prior.window, laplacian_out=a["laplacian"]
    )


def _nlm_neighbors(k: KernelSet, _: str, a: Arrays) -> Call:
    return lambda: k.nlm_neighbors(a["weights"], a["disparity"], window=CONFIG.prior.window, sums_out=a["sums"])


def _structure_tensor(k: KernelSet, device: str, a: Arrays) -> Call:
    filters = structure_filters(np.asarray(k.numpy(a["line_offsets"]), np.float64), CONFIG.local)
    placed = StructureFilters(*(k.field(f, device) for f in filters))
    tensor = k.structure_tensor(a["epis"], a["line_offsets"], placed, scale=BYTE, floor=CONFIG.local.gradient_floor)
    return lambda: tensor(1.0, a["disparity_out"], a["coherence"])


def _dot(k: KernelSet, _: str, a: Arrays) -> Call:
    return lambda: k.dot(a["disparity"], a["other_values"])


def _axpby(k: KernelSet, _: str, a: Arrays) -> Call:
    return lambda: k.axpby(0.75, a["disparity"], -0.5, a["other_values"], a["combined"])


_MAP = Slot("disparity", "yx")
_SPLATTED = (Slot("image", "yxc"), _MAP, Slot("offsets", "n2"))

OPERATIONS = (
    Operation(
        "data_term",
        (*_SPLATTED, Slot("recorded", "nyxc"), Slot("valid", "nyx")),
        (Slot("gradient", "yx"),),
        _data_term,
    ),
    Operation("splat", _SPLATTED, (Slot("views", "nyxc"), Slot("coverage", "nyx")), _splat),
    Operation("splat_vjp", (*_SPLATTED, Slot("residual", "nyxc")), (Slot("gradient", "yx"),), _splat_vjp),
    Operation(
        "splat_transpose",
        (_MAP, Slot("offsets", "n2"), Slot("residual", "nyxc")),
        (Slot("image_out", "yxc"),),
        _splat_transpose,
    ),
    Operation(
        "nlm_weights",
        (Slot("image", "yxc"),),
        (Slot("weights_out", "kyx"),),
        _nlm_weights,
        scratch=(Slot("scratch", "kyx"),),
    ),
    Operation("nlm_laplacian", (Slot("weights", "kyx"), _MAP), (Slot("laplacian", "yx"),), _nlm_laplacian),
    Operation("nlm_neighbors", (Slot("weights", "kyx"), _MAP), (Slot("sums", "yx"),), _nlm_neighbors),
    Operation(
        "structure_tensor",
        (Slot("epis", "uyxc", "uint8"), Slot("line_offsets", "u")),
        (Slot("disparity_out", "yx"), Slot("coherence", "yx")),
        _structure_tensor,
        trusted=("coherence", CONFIG.local.coherence_threshold),
    ),
    Operation("dot", (_MAP, Slot("other_values", "yx")), (), _dot, local=False),
    Operation("axpby", (_MAP, Slot("other_values", "yx")), (Slot("combined", "yx"),), _axpby),
)

assert all(slot.name in INPUTS for operation in OPERATIONS for slot in operation.reads)
