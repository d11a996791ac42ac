"""The checks of the solvers can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import solver_cases
import solver_checks
from lfgpu.kernels.reference import lbfgs as lbfgs_module
from single_faults import Check, Fault, single_fault_tests, values_of
from ways_to_be_wrong import argument, method, option, planned

from lfgpu.contract import KernelSet

RESIDUALS = solver_cases.ResidualsCase("residuals", residuals=(2.0, 3.0, 0.1, 0.05, 0.01, 0.01), tolerance=0.1, most=3)
LBFGS = solver_cases.LbfgsCase("lbfgs", bounds=(-0.25, 0.5), values=12)

value_of = values_of(
    solver_checks.OPERATIONS,
    {
        "residuals": lambda rng: solver_cases.residuals_inputs(RESIDUALS, rng),
        "lbfgs": lambda rng: solver_cases.lbfgs_inputs(LBFGS, rng),
    },
)


def way_of(**case: Any) -> Check:
    """The check of L-BFGS on another way."""
    return value_of("lbfgs", lambda rng: solver_cases.lbfgs_inputs(solver_cases.LbfgsCase("way", **case), rng))


def CONVERGES(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    solver_checks.check_lbfgs_converges(kernels, "cpu", solver_cases.quadratic(42, rng), rng.normal(size=(6, 7)), 1e-5)


def without_curvature(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *state: right(*state[:3])


def rejecting_nothing(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda value, trial_value: right(value + 1e9, trial_value)


def half_the_step(right: Callable[..., Any]) -> Callable[..., Any]:
    """Does not look at the parabola: a step that is not accepted is halved."""

    def wrong(value: Any, trial_value: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        step, count = solver._step, solver._rejected
        right(value, trial_value)
        if solver._rejected > count:
            solver._step = step / 2

    return wrong


def learning_anyway(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(*state: Any) -> None:
        right.__self__._accepted = True  # type: ignore[attr-defined]
        right(*state)

    return wrong


def keeping_pairs(right: Callable[..., Any]) -> Callable[..., Any]:
    """Begins with the pairs that it has."""

    def wrong(*state: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        pairs = list(solver._pairs)
        right(*state)
        solver._pairs.extend(pairs)
        solver._turn(*state[:2])

    return wrong


def dropping_a_pair(right: Callable[..., Any]) -> Callable[..., Any]:
    """A pair that is not kept takes the place of the oldest."""

    def wrong(*state: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        newest = solver._pairs[-1] if solver._pairs else None
        right(*state)
        kept = bool(solver._pairs) and solver._pairs[-1] is not newest
        if solver._accepted and not kept and len(solver._pairs) == solver._pairs.maxlen:
            solver._pairs.popleft()
            solver._turn(*state[:2])

    return wrong


def moving_inwards(right: Callable[..., Any]) -> Callable[..., Any]:
    """Pixels that the gradient holds at a bound are moved by what ties them to others."""

    def wrong(*state: Any) -> None:
        right(*state)
        solver, (x, gradient) = right.__self__, state[:2]  # type: ignore[attr-defined]
        if solver._accepted and solver._pairs:
            projected = lbfgs_module.projected_gradient(x, gradient, solver._low, solver._high)
            direction = -lbfgs_module.two_loop(solver._pairs, projected)
            stopped = ((x <= solver._low) & (direction < 0)) | ((x >= solver._high) & (direction > 0))
            solver._direction = np.where(stopped, 0, direction)

    return wrong


def outside(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(x: Any, trial_out: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        trial_out[:] = x + solver._step * solver._direction

    return wrong


def reporting(change: Callable[..., Any]) -> Callable[..., Any]:
    """Another report than the right one."""
    return method("report", lambda right: lambda: change(right()))


def adding(amount: float) -> Callable[..., Any]:
    """Each residual is larger by `amount`."""
    return method("add", lambda right: lambda residual: right(residual + amount))


def late_norm(plan: Any) -> Any:
    """The norm is looked at when a residual comes."""
    begin, add, norms = plan.begin, plan.add, []

    def add_wrong(residual: Any) -> None:
        plan._norm = float(norms[-1][0]) or 1.0
        add(residual)

    def begin_wrong(norm: Any) -> None:
        norms.append(norm)
        begin(norm)

    plan.begin, plan.add = begin_wrong, add_wrong
    return plan


STAIRS = {"function": "stairs", "size": (2, 2), "bounds": (-50.0, 50.0), "start": -30.0, "memory": 1, "values": 20}


def SMALL(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return solver_cases.residuals_inputs(replace(RESIDUALS, most=20), rng)


FAULTS = (
    # solvers
    Fault("tolerance ignored", "residuals", option("tolerance", lambda _: 0.0), value_of("residuals", SMALL)),
    Fault("without end", "residuals", option("most", lambda most: most + 1), value_of("residuals")),
    Fault("squared", "residuals", reporting(lambda trace: [r**2 for r in trace]), value_of("residuals")),
    Fault("begins with an old trace", "residuals", reporting(lambda trace: [1.0, *trace]), value_of("residuals")),
    Fault("norm ignored", "residuals", method("begin", argument(0, np.ones_like)), value_of("residuals")),
    Fault("norm not copied", "residuals", planned(lambda plan: late_norm(plan)), value_of("residuals")),
    Fault("larger", "residuals", adding(1e-3), value_of("residuals")),
    Fault("memory of one pair", "lbfgs", option("memory", lambda _: 1), value_of("lbfgs")),
    Fault("begins with old pairs", "lbfgs", method("begin", keeping_pairs), value_of("lbfgs")),
    Fault("curvature ignored", "lbfgs", method("begin", without_curvature), way_of(curvature=True)),
    Fault("no bound", "lbfgs", option("low", lambda _: -99.0), value_of("lbfgs")),
    Fault("no bound of trials", "lbfgs", method("propose", outside), value_of("lbfgs")),
    Fault("held pixels move", "lbfgs", method("learn", moving_inwards), value_of("lbfgs")),
    Fault("held pixels move, seen without a truth", "lbfgs", method("learn", moving_inwards), CONVERGES),
    Fault("first step too long", "lbfgs", option("first_step", lambda s: 1.1 * s), value_of("lbfgs")),
    Fault("takes every trial", "lbfgs", method("judge", rejecting_nothing), way_of(function="lie")),
    Fault(
        "halves its steps",
        "lbfgs",
        method("judge", half_the_step),
        way_of(first_step=50.0, bounds=(-999.0, 999.0), start=0.25),
    ),
    Fault("learns what it did not take", "lbfgs", method("learn", learning_anyway), way_of(function="lie")),
    Fault("a pair that is not kept takes a place", "lbfgs", method("learn", dropping_a_pair), way_of(**STAIRS)),
    Fault("never flat", "lbfgs", option("tolerance", lambda _: -1.0), way_of(flat=0.02, patience=2, values=20)),
    Fault("impatient", "lbfgs", option("patience", lambda _: 1), way_of(flat=0.02, patience=2, values=20)),
    Fault("without end", "lbfgs", option("most", lambda most: most + 1), way_of(most=3)),
    Fault("counts itself short", "lbfgs", reporting(lambda r: (r[0], r[1] - 1, r[2])), value_of("lbfgs")),
    Fault("always flat", "lbfgs", reporting(lambda r: (r[0], r[1], True)), value_of("lbfgs")),
    Fault("learns nothing, seen without a truth", "lbfgs", method("learn", lambda _: lambda *a: None), CONVERGES),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)
