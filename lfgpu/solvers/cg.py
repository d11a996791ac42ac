"""Conjugate gradients with a diagonal preconditioner, on a backend's vectors (Hestenes and Stiefel 1952)."""

from collections.abc import Callable, Sequence

from lfgpu.contract import Array, Device
from lfgpu.solvers.solution import Solution

_AT_ONCE = 8  # iterations: those past the tolerance change nothing, but each takes its time


class ConjugateGradients:
    """Solves A x = b for symmetric positive definite A. It runs entirely on the device, so that it can be captured.

    It stops when √(rᵀ M r) <= tolerance * √(bᵀ M b), with the residual r = b - A x and the preconditioner M. In this
    norm, unknowns with small and large diagonal entries count the same.
    """

    def __init__(self, shape: Sequence[int], device: Device, *, tolerance: float, max_iterations: int) -> None:
        kernels = device.kernels
        self._kernels, self._tolerance, self._most = kernels, tolerance, max_iterations
        self._r, self._p, self._q = (device.zeros(shape) for _ in range(3))
        self._rz, self._norm = (device.scalar(0.0) for _ in range(2))
        self._residuals = kernels.residuals(device.name, tolerance=tolerance, most=max_iterations)

    def solve(
        self,
        apply: Callable[[Array, Array], None],
        right_side: Array,
        preconditioner: Array,
        x: Array,
        callback: Callable[[int, float], None] | None = None,
    ) -> None:
        """Solve for `x`, a field [y, x], which holds the start.

        apply(x, result_out) writes A x. `right_side` is b. `preconditioner` approximates the inverse of the diagonal of
        A. All are fields. `callback` is called as callback(iteration, √(rᵀ M r) / √(bᵀ M b)); it makes the host wait.
        """
        k, r, p, q = self._kernels, self._r, self._p, self._q
        k.multiply(preconditioner, right_side, q)
        k.dot(right_side, q, self._norm)
        self._residuals.begin(self._norm)
        apply(x, r)
        k.axpby(1.0, right_side, -1.0, r, r)
        k.multiply(preconditioner, r, p)
        k.dot(r, p, self._rz)
        self._residuals.add(self._rz)

        told, go_on = 0, self._residuals.go_on

        def tell(listener: Callable[[int, float], None]) -> None:
            nonlocal told
            trace = self._residuals.report()
            if len(trace) - 1 > told:  # past the tolerance nothing happens
                told = len(trace) - 1
                listener(told, trace[-1])

        def iterate() -> None:
            apply(p, q)
            k.conjugate_step(p, q, preconditioner, self._rz, x, r, go_on)
            self._residuals.add(self._rz)
            if callback is not None:
                tell(callback)

        k.repeat(iterate, go_on, self._most, at_once=_AT_ONCE)

    def report(self) -> Solution:
        """Report the outcome of the last solve; waits for the device."""
        trace = self._residuals.report()
        iterations, converged = len(trace) - 1, trace[-1] <= self._tolerance
        reason = "the residual is small enough" if converged else "the limit of iterations is reached"
        return Solution(
            converged,
            f"conjugate gradients stopped after {iterations} iterations: {reason} ({trace[-1]:.1e}).",
            iterations,
            iterations + 1,
            tuple(trace),
        )
