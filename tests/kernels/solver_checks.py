"""The two solvers, conjugate gradients by their residuals and L-BFGS by what it is told: cases and checks."""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, float32, largest_error
from numpy.typing import NDArray

from lfgpu._backends import load
from lfgpu.contract import KernelSet


@dataclass(frozen=True)
class ResidualsCase(Case):
    """The residuals that a linear solver finds one after the other, and when it is to stop."""

    norm: float = 2.5
    residuals: tuple[float, ...] = (2.5, 1.0, 0.125, 1e-3, 1e-6, 1e-9)
    tolerance: float = 1e-2
    most: int = 20


RESIDUALS_CASES = (
    ResidualsCase("small enough at last"),
    ResidualsCase("small enough at once", residuals=(1e-9,)),
    ResidualsCase("as small as the tolerance", norm=4.0, residuals=(4.0, 1.0), tolerance=0.5),
    ResidualsCase("as many as may be", residuals=(3.0, 2.0, 1.0, 0.5), most=3),
    ResidualsCase("none may be", residuals=(3.0,), most=0),
    ResidualsCase("nothing to solve", norm=0.0, residuals=(0.0,)),
    ResidualsCase("relative to 1", norm=0.0, residuals=(0.25, 1e-2), tolerance=0.2),
    ResidualsCase("rounded below 0", residuals=(1.0, -1e-12)),
    ResidualsCase("up and down", residuals=(1.0, 4.0, 0.5, 8.0, 1e-5)),
    ResidualsCase("beyond float32", norm=1e-60, residuals=(1e-60, 1e-62), tolerance=1e-3),
)


def residuals_inputs(case: ResidualsCase, rng: np.random.Generator) -> SimpleNamespace:
    return SimpleNamespace(norm=case.norm, residuals=case.residuals, tolerance=case.tolerance, most=case.most)


@dataclass(frozen=True)
class LbfgsCase(Case):
    """A function of a field within bounds, where a solver starts, and how many values it judges."""

    function: str = "quadratic"
    size: tuple[int, int] = (5, 6)
    bounds: tuple[float, float] = (-1.0, 1.0)
    start: float | None = None  # everywhere; None is anywhere within the bounds
    values: int = 8
    memory: int = 4
    first_step: float = 0.1
    flat: float = 1e-9
    patience: int = 3
    most: int = 50
    curvature: bool = False
    """Whether the solver is told one for each pixel."""
    tolerance: float = 1e-4


LBFGS_CASES = (
    LbfgsCase("quadratic"),
    LbfgsCase("no bound near", bounds=(-100.0, 100.0), first_step=1.0),
    LbfgsCase("bounds everywhere", bounds=(-0.0625, 0.0625)),
    LbfgsCase("memory of one pair", memory=1),
    LbfgsCase("memory not full", memory=20),
    LbfgsCase("first step too long", first_step=50.0, bounds=(-1000.0, 1000.0), start=0.25),
    LbfgsCase("curved valley", function="rosenbrock", size=(2, 3), bounds=(-2.0, 2.0), start=-1.25, values=7),
    LbfgsCase("start on a bound", bounds=(-2.0, 0.5), start=0.5),
    LbfgsCase("start at the minimum", function="bowl", start=0.0),
    LbfgsCase("start in the corner where it ends", function="slope", start=-1.0),
    LbfgsCase("straight slope", function="slope", start=0.75, values=12),
    LbfgsCase("hill", function="hill", values=6),
    LbfgsCase("stairs", function="stairs", size=(2, 2), bounds=(-50.0, 50.0), start=-30.0, memory=1, values=20),
    LbfgsCase("wall", function="wall", bounds=(-100.0, 100.0), start=1.0, first_step=12.0, values=45),
    LbfgsCase("nothing lower", function="lie", values=25),
    LbfgsCase("flat at last", flat=0.02, patience=2, values=20),
    LbfgsCase("flat at first only", bounds=(-9.0, 9.0), first_step=1e-3, flat=0.02, patience=2, values=6),
    LbfgsCase("as many steps as may be", most=3),
    LbfgsCase("no step may be", most=0),
    LbfgsCase("one pixel", size=(1, 1), function="waves", values=4),
    LbfgsCase("waves", function="waves", bounds=(-3.0, 3.0), values=10),
    LbfgsCase("work for several threads", size=(61, 53), function="waves", bounds=(-3.0, 3.0)),
    LbfgsCase("curvature", curvature=True),
    LbfgsCase("curvature and bounds everywhere", bounds=(-0.0625, 0.0625), curvature=True),
)


@dataclass(frozen=True)
class Trial:
    """One trial of a solver, all in numbers that float32 can hold, but for the value."""

    x: NDArray[np.float32]
    gradient: NDArray[np.float32]
    value: float


def lbfgs_inputs(case: LbfgsCase, rng: np.random.Generator) -> SimpleNamespace:
    """What the reference asks for on its way and is told there: every backend is told the same, whatever it asks for.

    So one that differs a little does not go another way after some steps.
    """
    function = bounded_function(case, rng)
    low, high = case.bounds
    start = rng.uniform(low, high, case.size) if case.start is None else np.full(case.size, case.start)
    options = {
        "memory": case.memory,
        "low": low,
        "high": high,
        "first_step": case.first_step,
        "tolerance": case.flat,
        "patience": case.patience,
        "most": case.most,
    }
    first, curvature = _trial(function, start), None
    if case.curvature:
        curvature = 4.0 ** rng.integers(-2, 3, case.size)
    trials = _trials(case, function, first, options, curvature)
    return SimpleNamespace(first=first, curvature=curvature, trials=trials, options=options)


Function = Callable[[NDArray[np.float64]], tuple[float, NDArray[np.float64]]]
"""Value and gradient at x."""


def bounded_function(case: LbfgsCase, rng: np.random.Generator) -> Function:
    """The function that a case names, of the fields of its size."""
    count = case.size[0] * case.size[1]
    matrix, aim = quadratic(count, rng) if case.function == "quadratic" else (np.eye(1), np.zeros(1))
    phase = rng.uniform(0, 6, case.size)

    def value_and_gradient(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        if case.function == "quadratic":
            product = (matrix @ x.ravel() - aim).reshape(x.shape)
            return float(0.5 * x.ravel() @ matrix @ x.ravel() - aim @ x.ravel()), product
        if case.function == "rosenbrock":
            return _rosenbrock(x)
        if case.function == "waves":
            return float((np.sin(2 * x + phase) + 0.1 * x**2).sum()), 2 * np.cos(2 * x + phase) + 0.2 * x
        if case.function == "wall":  # before it everything falls, at it and beyond it nothing is finite
            return float(-x.sum()) if x.max() < 8 else np.inf if x.max() < 14 else np.nan, -np.ones_like(x)
        value, gradient = {
            "bowl": ((x**2).sum(), 2 * x),
            "slope": (x.sum(), np.ones_like(x)),
            "stairs": ((0.3 * np.cos(3 * x) - x).sum(), -0.9 * np.sin(3 * x) - 1),  # convex and concave by turns
            "hill": (-(x**2).sum(), -2 * x),
            "lie": ((x**2).sum(), -2 * x),
        }[case.function]
        return float(value), gradient

    return value_and_gradient


def quadratic(count: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A random symmetric matrix with eigenvalues from 1 to 30, and a vector: A and b of xᵀ A x / 2 - bᵀ x.

    Without bounds all of the minimum lies more than 0.6 from 0.
    """
    basis, _ = np.linalg.qr(rng.normal(size=(count, count)))
    values = np.geomspace(1, 30, count)
    matrix = basis * values @ basis.T
    return matrix, matrix @ (rng.choice([-1, 1], count) * rng.uniform(0.6, 1.5, count))


def _rosenbrock(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    a = x.ravel()
    beside = a[1:] - a[:-1] ** 2
    gradient = np.zeros_like(a)
    gradient[1:] += 20 * beside
    gradient[:-1] -= 40 * beside * a[:-1] + 2 * (1 - a[:-1])
    return float((10 * beside**2 + (1 - a[:-1]) ** 2).sum()), gradient.reshape(x.shape)


def _trial(function: Function, x: NDArray[np.float64]) -> Trial:
    x = float32(x)
    value, gradient = function(x.astype(np.float64))
    return Trial(x, float32(gradient), value)


def _trials(
    case: LbfgsCase, function: Function, first: Trial, options: dict[str, Any], curvature: NDArray[np.float64] | None
) -> list[Trial]:
    solver = load("reference").lbfgs(case.size, "cpu", **options)
    x, gradient = first.x.astype(np.float64), first.gradient.astype(np.float64)
    value, proposed = np.array([first.value]), np.empty(case.size)
    solver.begin(x, gradient, value, curvature)
    trials: list[Trial] = []
    while solver.go_on[0] and len(trials) < case.values:
        solver.propose(x, proposed)
        trial = _trial(function, proposed)
        trials.append(trial)
        solver.judge(value, np.array([trial.value]))
        solver.learn(x, gradient, trial.x.astype(np.float64), trial.gradient.astype(np.float64))
    return trials


def residuals(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The trace, and after each residual whether to go on, after another system, which leaves no trace."""
    plan, number = desk.kernels.residuals(desk.device, tolerance=i.tolerance, most=i.most), desk.kernels.number
    plan.begin(desk.number(0.5))
    for residual in (1e9, 0.0, 0.0, 0.0):
        plan.add(desk.number(residual))
    norm, go_on = desk.number_out(i.norm), []
    plan.begin(norm)
    desk.kernels.copy(desk.number(1e9), norm)  # what becomes of the number afterwards does not matter
    for residual in i.residuals:
        plan.add(desk.number(residual))
        go_on.append(number(plan.go_on))
    return {"trace": plan.report(), "go on": go_on}


def lbfgs(desk: Desk, i: SimpleNamespace) -> Outputs:
    """All that a solver asks for and decides on the way of the inputs, after a way of another one.

    `trial k` is what it proposes at `x k`.
    """
    kernels, shape = desk.kernels, i.first.x.shape
    plan = kernels.lbfgs(shape, desk.device, **i.options)
    _one_step(desk, plan, i)
    x, gradient, value = desk.held(i.first.x), desk.held(i.first.gradient), desk.number_out(i.first.value)
    plan.begin(x, gradient, value, None if i.curvature is None else desk.field(i.curvature))
    out: Outputs = {"values": [], "go on": [kernels.number(plan.go_on)]}
    for k, told in enumerate(i.trials):
        out |= {
            f"x {k}": desk.held(i.first.x),
            f"gradient {k}": desk.held(i.first.gradient),
            f"trial {k}": desk.out(shape),
        }
        kernels.copy(x, out[f"x {k}"])
        kernels.copy(gradient, out[f"gradient {k}"])
        plan.propose(x, out[f"trial {k}"])
        plan.judge(value, desk.number(told.value))
        plan.learn(x, gradient, desk.field(told.x), desk.field(told.gradient))
        out["values"].append(kernels.number(value))
        out["go on"].append(kernels.number(plan.go_on))
    trace, evaluations, flat = plan.report()
    return {**out, "trace": trace, "evaluations": float(evaluations), "flat": float(flat)}


def _one_step(desk: Desk, plan: Any, i: SimpleNamespace) -> None:
    """A step of a bowl, which the plan learns from, and another one that it does not take."""
    start = np.full(i.first.x.shape, (i.options["low"] + i.options["high"]) / 2 + 0.125)
    x, gradient, trial = desk.held(start), desk.held(2 * start), desk.out(start.shape)
    value, lower, higher = desk.number_out(9.0), desk.number(-1e6), desk.number(1e6)
    plan.begin(x, gradient, value, desk.field(np.full(start.shape, 3.0)))
    for told in (lower, higher):
        plan.propose(x, trial)
        plan.judge(value, told)
        plan.learn(x, gradient, desk.field(start / 2), desk.field(start))


def lbfgs_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Trials relative to the longest step of a pixel, but for the rounding of x + step."""
    errors = {name: largest_error(got[name], want[name]) for name in want if not name.startswith("trial")}
    for k in range(len(i.trials)):
        step = np.abs(want[f"trial {k}"] - want[f"x {k}"]).max()
        rounding = 2.0**-22 * np.abs(want[f"x {k}"]).max()
        off = np.abs(got[f"trial {k}"] - want[f"trial {k}"]).max()
        errors[f"trial {k}"] = float(max(0.0, off - rounding) / step) if step else float(off)
    return errors


OPERATIONS = (Operation(residuals, "residuals"), Operation(lbfgs, "lbfgs", lbfgs_errors))


Quadratic = tuple[Values, Values]


def check_sufficient_decrease(kernels: KernelSet, device: str) -> None:
    """A trial is accepted from 1e-4 of the decrease on that the slope promises (Armijo), and no sooner.

    The first step goes from 0 to -1 everywhere, against a gradient of 1: the slope promises 4.
    """
    for value, accepted in ((-0.9e-4 * 4, False), (-1.1e-4 * 4, True)):
        memory = kernels.lbfgs(
            (2, 2), device, memory=3, low=-9.0, high=9.0, first_step=1.0, tolerance=0.0, patience=5, most=5
        )
        x, gradient, trial, trial_gradient = (
            kernels.field(np.full((2, 2), number, np.float32), device) for number in (0.0, 1.0, 0.0, 0.5)
        )
        held = kernels.scalar(0.0, device)
        memory.begin(x, gradient, held)
        memory.propose(x, trial)
        np.testing.assert_allclose(kernels.numpy(trial), -1.0, rtol=1e-6)
        memory.judge(held, kernels.scalar(value, device))
        memory.learn(x, gradient, trial, trial_gradient)
        trace, _, _ = memory.report()
        assert trace == ([0.0, value] if accepted else [0.0]), f"a decrease of {-value} is judged wrongly: {trace}"
        np.testing.assert_allclose(kernels.numpy(x), -1.0 if accepted else 0.0, rtol=1e-6)


def check_lbfgs_converges(kernels: KernelSet, device: str, quadratic: Quadratic, start: Values) -> None:
    """It finds the minimum within bounds of xᵀ A x / 2 - bᵀ x, where many bounds hold: no truth but the conditions.

    Those of Karush, Kuhn and Tucker: the gradient is 0 where x is between the bounds, and leads out of them elsewhere.
    """
    matrix, aim = quadratic
    tolerance = 1e-5 if kernels.dtype is np.float64 else 1e-3
    low, high = -0.25, 0.5
    options = {"first_step": 0.05, "tolerance": 1e-14, "patience": 10, "most": 300}
    solver = kernels.lbfgs(start.shape, device, memory=8, low=low, high=high, **options)

    def evaluate(x: Any) -> tuple[float, Any]:
        flat = kernels.numpy(x).astype(np.float64).ravel()
        gradient = matrix @ flat - aim
        return float(flat @ (gradient - aim)) / 2, kernels.field(gradient.reshape(start.shape), device)

    x, trial = kernels.field(start.clip(low, high), device), kernels.zeros(start.shape, device)
    first, gradient = evaluate(x)
    value = kernels.scalar(first, device)
    solver.begin(x, gradient, value)
    judged = 0
    while kernels.number(solver.go_on) and judged < 1000:
        solver.propose(x, trial)
        proposed = kernels.numpy(trial)
        assert proposed.min() >= low, "a trial lies below the bounds"
        assert proposed.max() <= high, "a trial lies above the bounds"
        trial_value, trial_gradient = evaluate(trial)
        solver.judge(value, kernels.scalar(trial_value, device))
        solver.learn(x, gradient, trial, trial_gradient)
        judged += 1
    trace, evaluations, _ = solver.report()
    assert evaluations == judged + 1, "values are counted wrong"
    assert trace[0] == first, "the trace does not begin with the first value"
    assert trace[-1] == kernels.number(value), "the trace does not end with the last value"
    assert (np.diff(trace) <= 0).all(), "the value rises"
    found = kernels.numpy(x).astype(np.float64)
    slope = (matrix @ found.ravel() - aim).reshape(start.shape)
    free = slope[(found > low) & (found < high)]
    held = (found <= low) & (slope >= 0) | (found >= high) & (slope <= 0)
    assert held.any(), "no bound holds: the check says nothing"
    wrong = np.where(held | ((found > low) & (found < high)), 0, slope)
    error = max(np.abs(free).max(initial=0), np.abs(wrong).max()) / np.abs(aim).max()
    assert error <= tolerance, f"after {judged} values the gradient is still {error:.1e}, more than {tolerance:.0e}"
