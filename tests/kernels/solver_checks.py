"""The checks of the two solvers, step by step and as a whole."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Desk, Operation, Outputs, Values, largest_error

from lfgpu.contract import KernelSet


def residuals(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The trace, and after each residual whether to go on, after another system, which leaves no trace."""
    plan, number = desk.kernels.residuals(desk.device, tolerance=i.tolerance, most=i.most), desk.kernels.number
    plan.begin(desk.number(0.5))
    plan.add(desk.number(1e9))
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
