"""Bounded L-BFGS by scipy (Byrd, Lu, Nocedal and Zhu 1995), the optimiser of the paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from lfgpu.solvers.solution import Solution
from lfgpu.types import Float32Array, Float64Array

_REASONS = {0: "the energy no longer falls", 1: "the limit of iterations is reached"}  # scipy's status


def minimize_lbfgsb(
    value_and_gradient: Callable[[Float64Array], tuple[float, Float64Array]],
    start: Float32Array | Float64Array,
    bounds: tuple[float, float],
    *,
    tolerance: float,
    max_iterations: int,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    """Minimise a function of a map within bounds.

    Parameters
    ----------
    value_and_gradient
        Value and gradient [y, x] at a map [y, x], float64.
    start
        First guess [y, x]; moved into the bounds.
    bounds
        (low, high) of every pixel.
    tolerance
        Stop when an iteration lowers the value by less than this share of the first value.
    max_iterations
        Stop after as many.
    callback
        Called as callback(iteration, value).
    """
    shape = start.shape
    first = np.clip(start, *bounds).astype(np.float64)
    first_value, first_gradient = value_and_gradient(first)
    trace = [first_value]
    if max_iterations == 0:  # scipy would make one all the same
        return Solution(first.astype(np.float32), False, "no iteration was allowed.", 0, 1, tuple(trace))
    scale = 1.0 / (abs(first_value) or 1.0)  # then scipy's measure of a decrease is a share of the first value
    known = [(scale * first_value, scale * first_gradient.ravel())]  # scipy begins where we have been

    def scaled(x: Float64Array) -> tuple[float, Float64Array]:
        if known:
            return known.pop()
        value, gradient = value_and_gradient(x.reshape(shape))
        return scale * value, scale * gradient.ravel()

    def after_iteration(intermediate_result: object) -> None:
        trace.append(float(intermediate_result.fun) / scale)  # type: ignore[attr-defined]
        if callback is not None:
            callback(len(trace) - 1, trace[-1])

    result = minimize(
        scaled,
        first.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=[bounds] * first.size,
        callback=after_iteration,
        options={"maxiter": max_iterations, "maxfun": 10 * max_iterations + 10, "ftol": tolerance, "gtol": 0.0},
    )
    reason = _REASONS.get(result.status, "the line search finds nothing lower")
    return Solution(
        result.x.reshape(shape).astype(np.float32),
        bool(result.success),
        f"L-BFGS-B stopped after {result.nit} iterations: {reason} ({result.fun / scale:.6g}).",
        int(result.nit),
        int(result.nfev),
        tuple(trace),
    )
