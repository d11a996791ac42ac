"""L-BFGS-B of SciPy (Byrd, Lu, Nocedal and Zhu 1995), the optimiser of the paper; its vectors are on the host."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import Bounds, minimize
from threadpoolctl import threadpool_limits

from lfgpu.contract import Array, Device, Float64Array
from lfgpu.solvers.lbfgs import PATIENCE, Energy
from lfgpu.solvers.solution import Solution

_LIMIT = 1  # status of SciPy: limit of iterations


class ScipyLbfgsb:
    """Minimises a function of a map within bounds: the reference for `BoundedLbfgs`, with the same parameters."""

    def __init__(
        self,
        shape: Sequence[int],
        bounds: tuple[float, float],
        device: Device,
        *,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        kernels = device.kernels
        self._shape, self._bounds, self._kernels = tuple(shape), bounds, kernels
        self._tolerance, self._most = tolerance, max_iterations
        self._gradient, self._value = device.zeros(shape), device.scalar(0.0)
        self._solution: Solution | None = None

    def minimize(
        self,
        energy: Energy,
        x: Array,
        callback: Callable[[int, float], None] | None = None,
        *,
        curvature: Array | None = None,
    ) -> None:
        """Minimise over `x`, a field [y, x], calling callback(iteration, value). `curvature` is ignored."""
        kernels = self._kernels

        def value_and_gradient(values: Float64Array) -> tuple[float, Float64Array]:
            kernels.upload(values.reshape(self._shape), x)
            energy(x, self._gradient, self._value)
            return kernels.number(self._value), kernels.numpy(self._gradient).astype(np.float64).ravel()

        start = np.clip(kernels.numpy(x).astype(np.float64), *self._bounds)
        values, self._solution = self._minimum(value_and_gradient, start, callback)
        kernels.upload(values, x)

    def report(self) -> Solution:
        """Report the outcome of the last minimisation."""
        assert self._solution is not None, "nothing was minimised yet"
        return self._solution

    def _minimum(
        self,
        value_and_gradient: Callable[[Float64Array], tuple[float, Float64Array]],
        start: Float64Array,
        callback: Callable[[int, float], None] | None,
    ) -> tuple[Float64Array, Solution]:
        first_value, first_gradient = value_and_gradient(start)
        trace = [first_value]
        if self._most == 0:  # SciPy would make one iteration anyway
            return start, _solution(trace, 1, flat=False, reason="no iteration was allowed")
        scale = 1.0 / (abs(first_value) or 1.0)  # some thresholds of SciPy are absolute
        known = [(scale * first_value, scale * first_gradient)]  # SciPy evaluates the start again

        def scaled(x: Float64Array) -> tuple[float, Float64Array]:
            if known:
                return known.pop()
            value, gradient = value_and_gradient(x)
            return scale * value, scale * gradient

        def after_iteration(intermediate_result: object) -> None:
            trace.append(float(intermediate_result.fun) / scale)  # type: ignore[attr-defined]
            if callback is not None:
                callback(len(trace) - 1, trace[-1])
            if flat():
                raise StopIteration

        def flat() -> bool:
            last = trace[-PATIENCE - 1 :]
            return len(last) > PATIENCE and scale * (last[0] - last[-1]) <= PATIENCE * self._tolerance

        # One BLAS thread: for products of a few vectors, more threads only wait and slow down the kernels.
        with threadpool_limits(1, user_api="blas"):
            result = minimize(
                scaled,
                start.ravel(),
                jac=True,
                method="L-BFGS-B",
                bounds=Bounds(np.full(start.size, self._bounds[0]), np.full(start.size, self._bounds[1])),
                callback=after_iteration,
                options={"maxiter": self._most, "maxfun": 10 * self._most + 10, "ftol": 0.0, "gtol": 0.0},
            )
        converged = flat() or bool(result.success)
        if converged:
            reason = "the energy no longer falls"
        elif result.status == _LIMIT:
            reason = "the limit of iterations is reached"
        else:
            reason = "the line search finds nothing lower"
        return result.x.reshape(self._shape), _solution(trace, int(result.nfev), flat=converged, reason=reason)


def _solution(trace: list[float], evaluations: int, *, flat: bool, reason: str) -> Solution:
    iterations = len(trace) - 1
    status = f"L-BFGS-B stopped after {iterations} iterations: {reason} ({trace[-1]:.6g})."
    return Solution(flat, status, iterations, evaluations, tuple(trace))
