"""Bounded L-BFGS (Nocedal 1980) on the vectors of a backend; all decisions are made on the device."""

from collections.abc import Callable, Sequence

from lfgpu.contract import Array, Device, Scalar
from lfgpu.solvers.solution import Solution

_MEMORY = 7  # pairs; ten, as in SciPy's L-BFGS-B, save no iteration if the curvature is known
_FIRST_STEP = 0.04  # root mean square of the first step, pixels per view step at mean curvature
_AT_ONCE = 4  # iterations: those after the last one change nothing, but each takes its time
PATIENCE = 5  # iterations over which a decrease is judged; a single short step says little

Energy = Callable[[Array, Array, Scalar], None]
"""energy(x, gradient_out, value_out) at a field x [y, x]."""


class BoundedLbfgs:
    """Minimises a function of a map within bounds. It runs entirely on the device, so that it can be captured.

    Each iteration tries a step along the direction of the two-loop recursion, clamped to the bounds. If the value falls
    enough (Armijo), the trial is accepted, and its step and gradient change are stored; otherwise the step is
    shortened. Pixels at an active bound are left out of the direction. The recursion starts from the given curvature of
    each pixel, if any. It stops when the mean decrease over five iterations is below `tolerance` of the first value.
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
        self._kernels, self._bounds, self._most = kernels, bounds, max_iterations
        self._gradient, self._trial, self._trial_gradient = (device.zeros(shape) for _ in range(3))
        self._value, self._trial_value = device.scalar(0.0), device.scalar(0.0)
        self._memory = kernels.lbfgs(
            shape,
            device.name,
            memory=_MEMORY,
            low=bounds[0],
            high=bounds[1],
            first_step=_FIRST_STEP,
            tolerance=tolerance,
            patience=PATIENCE,
            most=max_iterations,
        )

    def minimize(
        self,
        energy: Energy,
        x: Array,
        callback: Callable[[int, float], None] | None = None,
        *,
        curvature: Array | None = None,
    ) -> None:
        """Minimise over `x`, a field [y, x] that holds the start; it is clamped to the bounds first.

        `callback` is called as callback(iteration, value); it makes the host wait. `curvature` [y, x] > 0 approximates
        the second derivative by each pixel, up to a factor; a good one saves iterations. None: the same for all pixels.
        """
        memory, value, trial_value = self._memory, self._value, self._trial_value
        gradient, trial, trial_gradient = self._gradient, self._trial, self._trial_gradient
        self._kernels.clamp(x, *self._bounds, x)
        energy(x, gradient, value)
        memory.begin(x, gradient, value, curvature)

        told = 0

        def tell(listener: Callable[[int, float], None]) -> None:
            nonlocal told
            trace, _, _ = memory.report()
            if len(trace) - 1 > told:  # a rejected trial is not an iteration
                told = len(trace) - 1
                listener(told, trace[-1])

        def iterate() -> None:
            memory.propose(x, trial)
            energy(trial, trial_gradient, trial_value)
            memory.judge(value, trial_value)
            memory.learn(x, gradient, trial, trial_gradient)
            if callback is not None:
                tell(callback)

        self._kernels.repeat(iterate, memory.go_on, 2 * self._most + 20, at_once=_AT_ONCE)

    def report(self) -> Solution:
        """Report the outcome of the last minimisation; waits for the device."""
        trace, evaluations, flat = self._memory.report()
        iterations = len(trace) - 1
        if iterations == 0 and evaluations == 1 and self._most > 0:  # there was no direction to try
            flat = True
        if flat:
            reason = "the energy no longer falls"
        elif iterations >= self._most:
            reason = "the limit of iterations is reached" if iterations else "no iteration was allowed"
        else:
            reason = "the line search finds nothing lower"
        return Solution(
            flat,
            f"L-BFGS stopped after {iterations} iterations: {reason} ({trace[-1]:.6g}).",
            iterations,
            evaluations,
            tuple(trace),
        )
