"""The plane sweep: cases, their random inputs, checks, and what holds whatever the truth is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import checks
import numpy as np
from checks import Desk, Operation, Outputs
from numpy.typing import NDArray

from lfgpu.contract import Disparities, KernelSet, PlaneSweep, SweepCost, ViewSets


@dataclass(frozen=True)
class SweepCase(checks.Case):
    """Views at `offsets` recorded as `dtype`, a sweep over `count` disparities, and view_sets to one side each."""

    size: tuple[int, int] = (11, 14)
    channels: int = 3
    dtype: str = "uint8"
    offsets: tuple[tuple[float, float], ...] = checks.grid(3, 3)
    masked: bool = False
    directions: int = 8
    first: float = -1.5
    step: float = 0.71875
    count: int = 5
    gradient_weight: float = 2.0
    softness: float = 0.05
    preference: float = 0.1
    least: int = 2


SWEEP_CASES = (
    SweepCase("colour uint8"),
    SweepCase("grey uint8 masked", channels=1, masked=True),
    SweepCase("colour float32 masked", dtype="float32", masked=True, size=(12, 9)),
    SweepCase("grey float32", dtype="float32", channels=1),
    SweepCase("colour float16", dtype="float16"),
    SweepCase("grey float16 masked", dtype="float16", channels=1, masked=True),
    SweepCase("colour uint16 masked", dtype="uint16", masked=True),
    SweepCase("grey uint16", dtype="uint16", channels=1, size=(9, 12)),
    SweepCase("one pixel wide", size=(13, 1)),
    SweepCase("one pixel high", size=(1, 13), channels=1, masked=True),
    SweepCase("one pixel", size=(1, 1), dtype="float32"),
    SweepCase("two by two", size=(2, 2), channels=1),
    SweepCase("one row of views", offsets=checks.grid(1, 5), masked=True, least=1),
    SweepCase("corner reference", offsets=tuple((u + 1, v + 1) for u, v in checks.grid(3, 3))),
    SweepCase("one view without offset", offsets=((0.0, 0.0),)),
    SweepCase("irregular offsets", offsets=checks.IRREGULAR, masked=True),
    SweepCase(
        "arbitrary numbers", offsets=((0.31, -1.2), (1.7, 0.9), (-0.4, 0.1)), first=-2.07, step=0.31, masked=True
    ),
    SweepCase("partly out of the frame", first=-9.0, step=2.1, masked=True),
    SweepCase("all out of the frame", first=20.0, offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    SweepCase("whole shifts", first=-2.0, step=1.0, count=5),
    SweepCase("one disparity", count=1, first=0.7),
    SweepCase("many views", offsets=checks.grid(5, 7), size=(7, 8), channels=1, masked=True, least=5),
    SweepCase("the first view_set alone", directions=0, masked=True),
    SweepCase("more view_sets than views", directions=31, offsets=checks.IRREGULAR),
    SweepCase("colours alone", gradient_weight=0.0, masked=True),
    SweepCase("no preference", preference=0.0, masked=True),
    SweepCase("differences as they are", softness=0.0, masked=True),
    SweepCase("differences as they are, colours alone", softness=0.0, gradient_weight=0.0),
    SweepCase("hardly more than roots", softness=1e-3, masked=True),
    SweepCase("wide", size=(5, 150)),
    SweepCase("high", size=(300, 3), channels=1, offsets=checks.IRREGULAR, masked=True, count=2),
    SweepCase("work for several threads", size=(53, 67), offsets=checks.grid(3, 4), masked=True, count=4),
)


def sweep_inputs(case: SweepCase, rng: np.random.Generator) -> SimpleNamespace:
    """A scene at one of the disparities but for noise, so that costs lie on both sides of where they are truncated."""
    shape, n = case.size, len(case.offsets)
    image = rng.random((*shape, case.channels)).astype(np.float32)
    intensities = 0.7 * image + 0.3 * rng.random((n, *shape, case.channels))
    offsets = np.array(case.offsets, np.float32)
    disparities = case.first + case.step * np.arange(case.count)
    tolerance = 0.25
    return SimpleNamespace(
        image=image,
        recorded=checks.stored(intensities, case.dtype),
        valid=(rng.random((n, *shape)) < 0.7).astype(np.float32) if case.masked else None,
        offsets=offsets,
        view_sets=sides(offsets, case.directions),
        nearest=surfaces((n, *shape), disparities + tolerance, rng),
        options={
            "first": case.first,
            "step": case.step,
            "count": case.count,
            "scale": checks.scale_of(case.dtype),
            "truncation": 0.25,
            "gradient_weight": case.gradient_weight,
            "gradient_truncation": 0.2,
            "softness": case.softness,
            "preference": case.preference,
            "tolerance": tolerance,
            "least": case.least,
        },
    )


def sides(offsets: NDArray[np.float32], directions: int) -> NDArray[np.float32]:
    """All views, and those on one side of the reference in each of so many directions."""
    angles = 2 * np.pi * np.arange(directions) / max(directions, 1)
    beside = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ offsets.astype(np.float64).T >= -1e-3
    return np.concatenate([np.ones((1, len(offsets))), beside]).astype(np.float32)


def surfaces(shape: tuple[int, ...], limits: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
    """Disparities of surfaces that hide about half, none so near to a limit that rounding decides; some are nowhere."""
    nearest = rng.uniform(limits[0] - 0.5, limits[-1] + 0.5, shape)
    nearest[np.abs(nearest[..., None] - limits).min(-1) < 1e-4] += 3e-4
    return np.where(rng.random(shape) < 0.1, -1e6, nearest).astype(np.float32)


def every_other(offsets: NDArray[np.float32]) -> NDArray[np.float32]:
    """Offsets [n, 2] with NaN for every other view, beginning with the second."""
    return np.where(np.arange(len(offsets))[:, None] % 2, np.float32(np.nan), offsets)


VOLUMES = "view_sets", "seen", "intensities", "some", "seen by some"
INTENSITY_TRUNCATION = 0.12  # of the last one


def planned(
    kernels: KernelSet,
    shape: Sequence[int],
    offsets: Any,
    view_sets: Any,
    *,
    first: float,
    step: float,
    count: int,
    scale: float,
    preference: float,
    tolerance: float,
    least: int,
    shared: PlaneSweep | None = None,
    **cost: float,
) -> tuple[PlaneSweep, SweepCost]:
    """The sweep and the cost that the options of a case describe."""
    views = ViewSets(offsets, view_sets, preference, tolerance, least)
    plan = kernels.plane_sweep(shape, views, Disparities(first, step, count), scale=scale, shared=shared)
    return plan, SweepCost(**cost)


def plane_sweep(desk: Desk, i: SimpleNamespace) -> Outputs:
    """All volumes after those of another light field, which leave no trace; and those of every other view."""
    offsets, view_sets = desk.field(i.offsets), desk.field(i.view_sets)
    plan, cost = planned(desk.kernels, i.recorded.shape, offsets, view_sets, **i.options)
    offsets = desk.field(every_other(i.offsets))
    part, _ = planned(desk.kernels, i.recorded.shape, offsets, view_sets, **i.options, shared=plan)
    intensities = SweepCost(INTENSITY_TRUNCATION, softness=cost.softness)
    shape = (i.options["count"], *i.image.shape[:2])
    out = {name: desk.out(shape) for name in VOLUMES}
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    desk.load_within(plan, i.image[::-1] + 1, i.recorded[:, ::-1], other_mask)
    plan.by_visibility(desk.field(i.nearest[:, ::-1]), cost, out["view_sets"])
    plan.by_visibility(desk.field(i.nearest[:, ::-1]), intensities, out["seen"])
    plan.by_view_sets(cost, out["intensities"])
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan.by_view_sets(cost, out["view_sets"])
    plan.by_visibility(desk.field(i.nearest), cost, out["seen"])
    plan.by_visibility(desk.field(i.nearest), intensities, out["intensities"])
    part.by_view_sets(cost, out["some"])
    left_out = np.isnan(every_other(i.offsets))[:, :1, None]
    part.by_visibility(desk.field(np.where(left_out, np.nan, i.nearest)), cost, out["seen by some"])
    return out


OPERATIONS = (Operation(plane_sweep, "sweep"),)
(SWEEP,) = OPERATIONS


def changed(i: SimpleNamespace, **values: Any) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(i), **values})


def most(i: SimpleNamespace, name: str) -> float:
    """Return the largest cost of a pixel in that volume."""
    if name == "intensities":
        return rooted(INTENSITY_TRUNCATION, i)
    weight, truncation = i.options["gradient_weight"], rooted(i.options["truncation"], i)
    return float((truncation + weight * i.options["gradient_truncation"]) / (1 + weight))


def rooted(difference: float, i: SimpleNamespace) -> float:
    """Return the cost of a difference in intensity."""
    softness = float(i.options["softness"])
    return 2 * softness * (math.sqrt(1 + difference / softness) - 1) if softness else difference
