"""The checks of the plane sweep: how to run it, and what holds whatever the truth is."""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Desk, Operation, Outputs, Values, adjoint_tolerance, compute, largest_error
from programs import Program
from sweep_cases import sides

from lfgpu.contract import Disparities, KernelSet, PlaneSweep, SweepCost, ViewSets

VOLUMES = "view_sets", "seen", "intensities"
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
    **cost: float,
) -> tuple[PlaneSweep, SweepCost]:
    """The sweep and the cost that the options of a case describe."""
    views = ViewSets(offsets, view_sets, preference, tolerance, least)
    return kernels.plane_sweep(shape, views, Disparities(first, step, count), scale=scale), SweepCost(**cost)


def plane_sweep(desk: Desk, i: SimpleNamespace) -> Outputs:
    """All volumes after those of another light field, which leave no trace."""
    offsets, view_sets = desk.field(i.offsets), desk.field(i.view_sets)
    plan, cost = planned(desk.kernels, i.recorded.shape, offsets, view_sets, **i.options)
    intensities = SweepCost(INTENSITY_TRUNCATION, softness=cost.softness)
    shape = (i.options["count"], *i.image.shape[:2])
    out = {name: desk.out(shape) for name in VOLUMES}
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1] + 1), desk.image(i.recorded[:, ::-1]), other_mask)
    plan.by_visibility(desk.field(i.nearest[:, ::-1]), cost, out["view_sets"])
    plan.by_visibility(desk.field(i.nearest[:, ::-1]), intensities, out["seen"])
    plan.by_view_sets(cost, out["intensities"])
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan.by_view_sets(cost, out["view_sets"])
    plan.by_visibility(desk.field(i.nearest), cost, out["seen"])
    plan.by_visibility(desk.field(i.nearest), intensities, out["intensities"])
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


# --- checks that know no truth ---


def check_masked_view_is_a_missing_view(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """A view without a valid pixel gives what the light field without that view gives; a mask of ones is none."""
    valid = np.ones(i.recorded.shape[:3], np.float32)
    no_mask, all_valid = (compute(kernels, device, SWEEP, changed(i, valid=mask)) for mask in (None, valid))
    valid[0] = 0
    fewer = {name: getattr(i, name)[1:] for name in ("recorded", "offsets", "nearest")}
    masked = compute(kernels, device, SWEEP, changed(i, valid=valid))
    missing = compute(kernels, device, SWEEP, changed(i, **fewer, view_sets=i.view_sets[:, 1:], valid=None))
    tolerance = adjoint_tolerance(kernels)
    for name in missing:
        assert largest_error(masked[name], missing[name]) <= tolerance, f"a masked view changes {name}"
        assert largest_error(all_valid[name], no_mask[name]) <= tolerance, f"a mask of ones changes {name}"


def check_nothing_valid_costs_the_most(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    unseen = changed(i, valid=np.zeros(i.recorded.shape[:3]))
    for name, volume in compute(kernels, device, SWEEP, unseen).items():
        np.testing.assert_allclose(volume, most(i, name), rtol=1e-6, atol=0, err_msg=f"{name} without a valid pixel")


def check_a_side_that_sees_is_enough(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """A plane at disparity 2, seen by all but the left views, which something brighter hides from them."""
    height, width = 9, 13
    offsets = np.array([(u, v) for v in (-1, 0, 1) for u in (-1, 0, 1)], np.float32)
    rng = np.random.default_rng(7)
    scene = rng.random((height + 4, width + 4, 1)).astype(np.float32)
    image = scene[2:-2, 2:-2]
    # At disparity 2 the view at (du, dv) shows at p - 2 (du, dv) what the reference shows at p.
    starts = [(2 + int(2 * dv), 2 + int(2 * du)) for du, dv in offsets]
    recorded = np.stack([scene[y : y + height, x : x + width] for y, x in starts])
    near = np.full(recorded.shape[:3], 2.0, np.float32)
    hidden = offsets[:, 0] < 0
    recorded[hidden] += 0.7
    near[hidden] = 3.0
    options = {**i.options, "first": 0.0, "step": 1.0, "count": 4, "scale": 1.0, "least": 1, "tolerance": 0.5}
    values = {"image": image, "recorded": recorded, "valid": None, "offsets": offsets, "nearest": near}
    got = compute(kernels, device, SWEEP, changed(i, **values, view_sets=sides(offsets, 8), options=options))
    inner = np.s_[:, 3:-3, 3:-3]  # where all views take part, and see the neighbours too
    np.testing.assert_allclose(got["view_sets"][2:3][inner], 1e-4, rtol=0, atol=1e-6, err_msg="a side that sees")
    for name in ("seen", "intensities"):
        np.testing.assert_allclose(got[name][2:3][inner], 0, rtol=0, atol=1e-6, err_msg=f"{name}: those that see")
    for name, volume in got.items():
        others = np.delete(volume, 2, axis=0)[inner]
        assert others.min() > 0.01, f"{name}: the plane seems to be elsewhere too"


# --- a program of it, for devices that can do work as a whole ---


def sweeping(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """All volumes of a light field that is loaded each time."""
    views, offsets = values["recorded"], values["offsets"]
    inputs = {name: kernels.image(values[name], device) for name in ("image", "recorded")}
    inputs |= {name: kernels.field(values[name], device) for name in ("valid", "nearest")}
    plan, cost = planned(
        kernels,
        views.shape,
        kernels.field(offsets, device),
        kernels.field(sides(offsets, 4), device),
        first=-1.0,
        step=0.5,
        count=5,
        scale=1.0,
        truncation=0.3,
        gradient_weight=2.0,
        gradient_truncation=0.2,
        softness=0.02,
        preference=0.2,
        tolerance=0.1003,
        least=1,
    )
    shape = (5, *views.shape[1:3])
    intensities = SweepCost(INTENSITY_TRUNCATION, softness=cost.softness)
    volumes = {name: kernels.zeros(shape, device) for name in VOLUMES}

    def work() -> None:
        plan.load(inputs["image"], inputs["recorded"], inputs["valid"])
        plan.by_view_sets(cost, volumes["view_sets"])
        plan.by_visibility(inputs["nearest"], cost, volumes["seen"])
        plan.by_visibility(inputs["nearest"], intensities, volumes["intensities"])

    return Program(inputs, work, volumes)
