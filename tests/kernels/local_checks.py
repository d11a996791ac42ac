"""The local estimate, that is the structure tensor of EPIs and the more coherent of two estimates: cases and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, coarse, float32, largest_error, scale_of, stored

from lfgpu.contract import StructureFilters
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import structure_filters


@dataclass(frozen=True)
class EpiCase(Case):
    """EPIs of one line of views at `offsets`, with a true disparity around `shear`."""

    size: tuple[int, int] = (5, 24)
    channels: int = 3
    dtype: str = "float32"
    offsets: tuple[float, ...] = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
    shear: float = 0.0
    floor: float = 1e-3
    tolerance: float = 1e-5


EPI_CASES = (
    EpiCase("colour"),
    EpiCase("grey", channels=1),
    EpiCase("colour uint8", dtype="uint8", shear=1.0),
    EpiCase("grey uint8", channels=1, dtype="uint8", shear=-1.0),
    EpiCase("colour uint16", dtype="uint16"),
    EpiCase("grey uint16", channels=1, dtype="uint16", shear=2.0),
    EpiCase("colour float16", dtype="float16"),
    EpiCase("fractional shear", shear=-1.375),
    EpiCase("shear of many digits", shear=-0.7310585),
    EpiCase("shear beyond the image", shear=16.0),
    EpiCase("reference at the left end", offsets=(0.0, 1.0, 2.0, 3.0, 4.0), shear=1.0),
    EpiCase("irregular offsets", offsets=(-2.25, -0.875, 0.0, 1.109375, 3.5), shear=0.5),
    EpiCase("two views", offsets=(0.0, 1.0), channels=1),
    EpiCase("one pixel wide", size=(9, 1)),
    EpiCase("one pixel high", size=(1, 17), shear=-0.5),
    EpiCase("high floor", floor=0.25),
    EpiCase("a view missing", offsets=(-2.0, -1.0, 0.0, 2.0, 3.0), dtype="uint8"),
    EpiCase("work for several threads", size=(41, 67), dtype="uint8", shear=0.5),
)


def epi_inputs(case: EpiCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random patterns that move by about `shear` a view, with noise: coherent here, less so there."""
    y, x = np.mgrid[: case.size[0], : case.size[1]]
    disparity = case.shear + rng.uniform(-0.6, 0.6)
    epis = np.empty((len(case.offsets), *case.size, case.channels))
    for c in range(case.channels):
        waves = rng.uniform(0.3, 1.2, 3), rng.uniform(-0.5, 0.5, 3), rng.uniform(0, 6.3, 3)
        for epi, offset in zip(epis, case.offsets, strict=True):
            phases = (a * (x + disparity * offset) + b * y + phase for a, b, phase in zip(*waves, strict=True))
            epi[..., c] = 0.5 + sum(np.sin(phase) for phase in phases) / 7
    epis += rng.uniform(-0.06, 0.06, epis.shape) * (y[..., None] % 3)
    filters = structure_filters(np.array(case.offsets), LocalConfig())
    return SimpleNamespace(
        epis=stored(epis.clip(0, 1), case.dtype),
        offsets=float32(np.array(case.offsets)),
        filters=type(filters)(*map(float32, filters)),
        scale=scale_of(case.dtype),
        shear=case.shear,
        floor=case.floor,
    )


@dataclass(frozen=True)
class CoherenceCase(Case):
    """An estimate and the best so far; disparities and coherences that tie and lie on bounds as often as not."""

    size: tuple[int, int] = (11, 14)
    shear: float = 0.5
    reach: float = 1.0
    unit: float = 1.0
    bounds: tuple[float, float] = (-0.25, 1.75)
    trusted: bool = True
    vertical: bool = False
    tolerance: float = 1e-6


COHERENCE_CASES = (
    CoherenceCase("trusted here and there"),
    CoherenceCase("bounds within reach", bounds=(-0.25, 1.25)),
    CoherenceCase("trusted everywhere", trusted=False),
    CoherenceCase("vertical", vertical=True),
    CoherenceCase("vertical trusted everywhere", vertical=True, trusted=False),
    CoherenceCase("wide views", unit=2.0, shear=-1.5, bounds=(-1.0, 0.0)),
    CoherenceCase("narrow views", unit=0.5, vertical=True, bounds=(-1.0, 2.0)),
    CoherenceCase("views at thirds", unit=3.0, shear=2.0, bounds=(0.3, 0.9)),
    CoherenceCase("out of bounds", bounds=(5.0, 6.0)),
    CoherenceCase("one pixel", size=(1, 1)),
    CoherenceCase("one row", size=(1, 13), vertical=True),
    CoherenceCase("work for several threads", size=(61, 38), vertical=True),
)


def coherence_inputs(case: CoherenceCase, rng: np.random.Generator) -> SimpleNamespace:
    """Two estimates one after the other, and the best so far, which has other sides than they where `vertical`."""
    shape = case.size[::-1] if case.vertical else case.size
    estimates = [
        SimpleNamespace(
            disparity=coarse(case.shear + rng.uniform(-1.5, 1.5, shape) * case.reach, 0.125),
            coherence=coarse(rng.random(shape), 0.125),
            trusted=float32(rng.random(shape) < 0.7) * np.float32(0.5) if case.trusted else None,
        )
        for _ in range(2)
    ]
    return SimpleNamespace(
        estimates=estimates,
        best_disparity=float32(rng.normal(size=case.size)),
        best_coherence=coarse(rng.random(case.size), 0.125),
        options={
            "shear": case.shear,
            "reach": case.reach,
            "unit": case.unit,
            "low": case.bounds[0],
            "high": case.bounds[1],
            "vertical": case.vertical,
        },
    )


def structure_tensor(desk: Desk, i: SimpleNamespace) -> Outputs:
    filters = StructureFilters(*map(desk.field, i.filters))
    plan = desk.kernels.structure_tensor(i.epis.shape, desk.field(i.offsets), filters, scale=i.scale, floor=i.floor)
    shape = i.epis.shape[1:3]
    plan(desk.image(i.epis[::-1, ::-1]), i.shear + 1.0, desk.out(shape), desk.out(shape))  # leaves no trace
    out = {"disparity": desk.out(shape), "coherence": desk.out(shape)}
    plan(desk.image(i.epis), i.shear, out["disparity"], out["coherence"])
    return out


def keep_more_coherent(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"disparity": desk.held(i.best_disparity), "coherence": desk.held(i.best_coherence)}
    for estimate in i.estimates:
        desk.kernels.keep_more_coherent(
            desk.field(estimate.disparity),
            desk.field(estimate.coherence),
            None if estimate.trusted is None else desk.field(estimate.trusted),
            **i.options,
            best_disparity_out=out["disparity"],
            best_coherence_out=out["coherence"],
        )
    return out


def structure_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The angle between the two directions, not their tangents, as far as the tensor has a direction at all.

    The angle is that of (J_xx - J_uu, 2 J_xu), whose length is √coherence times the trace; its error in float32 is
    relative to the trace. One turn of that vector is half a turn of the direction.
    """
    angle = np.arctan(got["disparity"].astype(np.float64) - i.shear) - np.arctan(want["disparity"] - i.shear)
    direction = np.sqrt(want["coherence"].clip(0)) * np.abs(np.sin(angle))
    return {"disparity": float(direction.max()), "coherence": largest_error(got["coherence"], want["coherence"], 1.0)}


STRUCTURE_TENSOR = Operation(structure_tensor, "epi", structure_errors)
KEEP_MORE_COHERENT = Operation(keep_more_coherent, "coherence")
OPERATIONS = (STRUCTURE_TENSOR, KEEP_MORE_COHERENT)
