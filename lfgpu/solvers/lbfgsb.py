"""L-BFGS-B of SciPy (Byrd, Lu, Nocedal and Zhu 1995), the optimiser of the paper; its vectors are on the host."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import Bounds, minimize
from threadpoolctl import threadpool_limits

from lfgpu.contract import Array, Device, Float64Array
from lfgpu.solvers.lbfgs import PATIENCE, Energy
from lfgpu.solvers.solution import Solution

_LIMIT = 1  # status of SciPy: limit of iterations


class ScipyLbfgsb:
    """Minimises a function of a map within bounds: the reference for `BoundedLbfgs`, with the same parameters.

    The unknowns are the pixels times the root of their curvature, so that all of them count the same.
    """

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
        small: float | None = None,
    ) -> None:
        """Minimise over `x`, a field [y, x], calling callback(iteration, value); `curvature` as for `BoundedLbfgs`.

        `small` is the norm of the gradient by the unknowns at which to stop; None: the decrease of the energy tells.
        """
        kernels = self._kernels
        root = np.ones(self._shape) if curvature is None else np.sqrt(kernels.numpy(curvature).astype(np.float64))

        def value_and_gradient(values: Float64Array) -> tuple[float, Float64Array]:
            kernels.upload(values.reshape(self._shape) / root, x)
            energy(x, self._gradient, self._value)
            return kernels.number(self._value), (kernels.numpy(self._gradient).astype(np.float64) / root).ravel()

        bounds = Bounds(*((bound * root).ravel() for bound in self._bounds))
        start = np.clip((kernels.numpy(x).astype(np.float64) * root).ravel(), bounds.lb, bounds.ub)
        values, self._solution = self._minimum(value_and_gradient, start, bounds, callback, small)
        kernels.upload(values.reshape(self._shape) / root, x)

    def report(self) -> Solution:
        """Report the outcome of the last minimisation."""
        assert self._solution is not None, "nothing was minimised yet"
        return self._solution

    def _minimum(
        self,
        value_and_gradient: Callable[[Float64Array], tuple[float, Float64Array]],
        start: Float64Array,
        bounds: Bounds,
        callback: Callable[[int, float], None] | None,
        small: float | None,
    ) -> tuple[Float64Array, Solution]:
        first_value, first_gradient = value_and_gradient(start)
        trace, norm = [first_value], float(np.linalg.norm(first_gradient))
        if self._most == 0:  # SciPy would make one iteration anyway
            return start, _solution(trace, 1, flat=False, reason="no iteration was allowed")
        scale = 1.0 / (abs(first_value) or 1.0)  # some thresholds of SciPy are absolute
        known = [(scale * first_value, scale * first_gradient)]  # SciPy evaluates the start again

        def scaled(x: Float64Array) -> tuple[float, Float64Array]:
            nonlocal norm
            if known:
                return known.pop()
            value, gradient = value_and_gradient(x)
            norm = float(np.linalg.norm(gradient))
            return scale * value, scale * gradient

        def after_iteration(intermediate_result: object) -> None:
            trace.append(float(intermediate_result.fun) / scale)  # type: ignore[attr-defined]
            if callback is not None:
                callback(len(trace) - 1, trace[-1])
            if done():
                raise StopIteration

        def done() -> bool:
            if small is not None:
                return norm <= small
            last = trace[-PATIENCE - 1 :]
            return len(last) > PATIENCE and scale * (last[0] - last[-1]) <= PATIENCE * self._tolerance

        # One BLAS thread: for products of a few vectors, more threads only wait and slow down the kernels.
        with threadpool_limits(1, user_api="blas"):
            result = minimize(
                scaled,
                start,
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                callback=after_iteration,
                options={"maxiter": self._most, "maxfun": 10 * self._most + 10, "ftol": 0.0, "gtol": 0.0},
            )
        converged = done() or (small is None and bool(result.success))
        if converged:
            reason = "the energy no longer falls" if small is None else "the gradient is small enough"
        elif result.get("status") == _LIMIT:  # it has none where bounds fix all unknowns
            reason = "the limit of iterations is reached"
        else:
            reason = "the line search finds nothing lower"
        return result.x, _solution(trace, int(result.nfev), flat=converged, reason=reason)


def _solution(trace: list[float], evaluations: int, *, flat: bool, reason: str) -> Solution:
    iterations = len(trace) - 1
    status = f"L-BFGS-B stopped after {iterations} iterations: {reason} ({trace[-1]:.6g})."
    return Solution(flat, status, iterations, evaluations, tuple(trace))
