"""Bounded L-BFGS by scipy (Byrd, Lu, Nocedal and Zhu 1995), the optimiser of the paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import Bounds, minimize
from threadpoolctl import threadpool_limits

from lfgpu.solvers.solution import Solution
from lfgpu.types import Float32Array, Float64Array

_PATIENCE = 5  # iterations over which a decrease is judged: a single short step says little
_LIMIT = 1  # scipy's status


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
        Stop when iterations lower the value by less than this share of the first value, five of them on average.
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
    scale = 1.0 / (abs(first_value) or 1.0)  # some of scipy's thresholds are absolute
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
        if flat(trace):
            raise StopIteration

    def flat(values: list[float]) -> bool:
        last = values[-_PATIENCE - 1 :]
        return len(last) > _PATIENCE and scale * (last[0] - last[-1]) <= _PATIENCE * tolerance

    # The products are of a few vectors: BLAS threads spend longer waiting for each other, and hold up the kernels.
    with threadpool_limits(1, user_api="blas"):
        result = minimize(
            scaled,
            first.ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=Bounds(np.full(first.size, bounds[0]), np.full(first.size, bounds[1])),
            callback=after_iteration,
            options={"maxiter": max_iterations, "maxfun": 10 * max_iterations + 10, "ftol": 0.0, "gtol": 0.0},
        )
    converged = flat(trace) or bool(result.success)
    if converged:
        reason = "the energy no longer falls"
    elif result.status == _LIMIT:
        reason = "the limit of iterations is reached"
    else:
        reason = "the line search finds nothing lower"
    return Solution(
        result.x.reshape(shape).astype(np.float32),
        converged,
        f"L-BFGS-B stopped after {len(trace) - 1} iterations: {reason} ({trace[-1]:.6g}).",
        len(trace) - 1,
        int(result.nfev),
        tuple(trace),
    )
