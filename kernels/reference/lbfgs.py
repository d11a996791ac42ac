"""The memory of a limited-memory BFGS solver within bounds: NumPy, float64 (Nocedal 1980).

The projected gradient is 0 where a bound stops x from going against it. The direction is 0 where a bound stops x from
going along it, and where x is at a bound and the projected gradient is 0: pairs tie pixels to each other, and would
move such a pixel inwards, uphill, so that no step along the direction needs to lower the value. The line search
backtracks: to the minimum of the parabola through both values and the slope, but not too far and not too little.

Pairs and the gradient are kept in units in which the curvature that the caller expects is 1 at each pixel: from that
the recursion begins, instead of from the same curvature for all.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from lfgpu.contract import Float64Array as Array

Pairs = deque[tuple[Array, Array]]  # (s, y), the newest last

DECREASE = 1e-4  # share of the decrease that the slope promises which is enough (Armijo)
LEAST_SHRINK, MOST_SHRINK = 0.5, 0.1  # a step that is not accepted becomes between 0.1 and 0.5 of itself
MOST_REJECTIONS = 20  # in a row
LEAST_CURVATURE = 1e-10  # of s . y relative to |s| |y|


def projected_gradient(x: Array, gradient: Array, low: float, high: float) -> Array:
    """Compute the gradient, but 0 where x is at a bound and would leave it against the gradient."""
    stopped = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    return np.where(stopped, 0.0, gradient)


def within_bounds(direction: Array, x: Array, projected: Array, low: float, high: float) -> Array:
    """Compute the direction, but 0 where x is at a bound and the direction leads out or the projected gradient is 0."""
    stopped = ((x <= low) & (direction < 0)) | ((x >= high) & (direction > 0))
    held = ((x <= low) | (x >= high)) & (projected == 0)
    return np.where(stopped | held, 0.0, direction)


def two_loop(pairs: Pairs, gradient: Array) -> Array:
    """Compute the inverse Hessian that `pairs` (at least one) make, times the gradient."""
    q = gradient.copy()
    alphas = []
    for s, y in reversed(pairs):
        alphas.append(np.vdot(s, q) / np.vdot(s, y))
        q -= alphas[-1] * y
    s, y = pairs[-1]
    q *= np.vdot(s, y) / np.vdot(y, y)
    for (s, y), alpha in zip(pairs, reversed(alphas), strict=True):
        q += (alpha - np.vdot(y, q) / np.vdot(s, y)) * s
    return q


class lbfgs:
    """The last pairs, the direction [y, x] with its slope and step, and the trace of accepted values."""

    def __init__(
        self,
        shape: Sequence[int],
        device: str,
        *,
        memory: int,
        low: float,
        high: float,
        first_step: float,
        tolerance: float,
        patience: int,
        most: int,
    ) -> None:
        self.go_on: Array = np.zeros(1)
        self._low, self._high, self._first_step = low, high, first_step
        self._tolerance, self._patience, self._most = tolerance, patience, most
        self._pairs: Pairs = deque(maxlen=memory)
        self._root = np.ones(shape)  # of the curvature
        self._direction, self._slope, self._step = np.zeros(shape), 0.0, 0.0
        self._trace: list[float] = []
        self._judged, self._rejected, self._accepted = 0, 0, False

    def begin(self, x: Array, gradient: Array, value: Array, curvature: Array | None = None) -> None:
        self._pairs.clear()
        self._root[:] = 1.0 if curvature is None else np.sqrt(curvature)
        self._trace = [float(value[0])]
        self._judged, self._rejected, self._accepted = 0, 0, False
        self.go_on[0] = self._most > 0
        self._turn(x, gradient)

    def propose(self, x: Array, trial_out: Array) -> None:
        trial_out[:] = np.clip(x + self._step * self._direction, self._low, self._high)

    def judge(self, value: Array, trial_value: Array) -> None:
        old, new = float(value[0]), float(trial_value[0])
        self._judged += 1
        self._accepted = bool(np.isfinite(new)) and new <= old + DECREASE * self._step * self._slope
        if self._accepted:
            value[0] = new
            self._trace.append(new)
            self._rejected = 0
            if self._flat() or len(self._trace) == self._most + 1:
                self.go_on[0] = 0
        else:
            self._step = self._shorter(old, new)
            self._rejected += 1
            if self._rejected == MOST_REJECTIONS:
                self.go_on[0] = 0

    def learn(self, x: Array, gradient: Array, trial: Array, trial_gradient: Array) -> None:
        if not self._accepted:
            return
        s, y = (trial - x) * self._root, (trial_gradient - gradient) / self._root
        if np.vdot(s, y) > LEAST_CURVATURE * np.linalg.norm(s) * np.linalg.norm(y):
            self._pairs.append((s, y))
        x[:], gradient[:] = trial, trial_gradient
        self._turn(x, gradient)

    def report(self) -> tuple[list[float], int, bool]:
        return list(self._trace), self._judged + 1, self._flat()

    def _turn(self, x: Array, gradient: Array) -> None:
        """Compute the next direction, its slope and the step along it."""
        projected = projected_gradient(x, gradient, self._low, self._high) / self._root
        if self._pairs:
            direction, self._step = -two_loop(self._pairs, projected), 1.0
            self._slope = float(np.vdot(projected, direction))
            if not self._slope < 0:  # rounding has spoiled the pairs
                self._pairs.clear()
        if not self._pairs:
            direction, self._slope = -projected, -float(np.vdot(projected, projected))
            self._step = self._first_step / np.sqrt((direction**2).mean()) if self._slope < 0 else 0.0
        if self._step == 0:
            self.go_on[0] = 0
        self._direction = within_bounds(direction / self._root, x, projected, self._low, self._high)

    def _shorter(self, old: float, new: float) -> float:
        """Choose a step to try after one that led from value `old` to `new` was not accepted."""
        step = self._step
        if not np.isfinite(new):
            return MOST_SHRINK * step
        lowest = -self._slope * step**2 / (2 * (new - old - self._slope * step))
        return float(np.clip(lowest, MOST_SHRINK * step, LEAST_SHRINK * step))

    def _flat(self) -> bool:
        """True if the last steps hardly lowered the value."""
        last = self._trace[-self._patience - 1 :]
        enough = self._patience * self._tolerance * abs(self._trace[0])
        return len(last) == self._patience + 1 and last[0] - last[-1] <= enough
