"""Solvers on a device: vector operations on fields, and the memory of iterative solvers."""

from collections.abc import Sequence
from typing import Protocol

from lfgpu.contract.arrays import Array, Scalar


class Vectors(Protocol):
    """Vector operations of solvers."""

    def dot(self, a: Array, b: Array, product_out: Scalar) -> None:
        """Compute the inner product, accumulated in float64."""

    def ratio(self, numerator: Scalar, denominator: Scalar, ratio_out: Scalar, *, factor: float = 1.0) -> None:
        """Compute factor * numerator / denominator; 0 where the denominator is 0. `ratio_out` may be one of them."""

    def copy(self, source: Array, target_out: Array) -> None:
        """Copy a field to a field, or a scalar to a scalar."""

    def axpby(self, alpha: float | Scalar, x: Array, beta: float | Scalar, y: Array, y_out: Array) -> None:
        """Compute y_out = alpha x + beta y; `y_out` may be `x` or `y`. Scalars x, y and y_out take plain numbers."""

    def multiply(self, x: Array, y: Array, product_out: Array) -> None:
        """Multiply element by element; `product_out` may be `x` or `y`."""

    def divide(self, x: Array, y: Array, quotient_out: Array) -> None:
        """Divide element by element, 0 where y is 0; `quotient_out` may be `x` or `y`."""

    def fill(self, value: float | Scalar, x_out: Array) -> None:
        """Set each element to `value`."""

    def select(self, condition: Array, x: Array, y: Array, chosen_out: Array) -> None:
        """Take x where condition > 0, else y, element by element; `chosen_out` may be any of them."""

    def threshold(self, x: Array, threshold: float, x_out: Array) -> None:
        """Keep x where x >= threshold, else 0; `x_out` may be `x`."""

    def clamp(self, x: Array, low: float, high: float, x_out: Array) -> None:
        """Move each element into [low, high]; `x_out` may be `x`."""


class Residuals(Protocol):
    """Residuals of a linear solver after each iteration, and its stopping rule, on a device."""

    go_on: Scalar  # 1 while there is something to do; then 0, and 1 less with each iteration that does nothing

    def begin(self, norm: Scalar) -> None:
        """Forget everything; residuals are relative to `norm`, or to 1 if that is 0."""

    def add(self, residual: Scalar) -> None:
        """Add sqrt(max(residual, 0) / norm) to the trace; `go_on` becomes 0 unless it is larger than the tolerance and
        less than `most` + 1 are there. Once `go_on` is 0 or less, take 1 from it and add nothing.
        """

    def report(self) -> list[float]:
        """Return the trace; waits for the device."""


class Lbfgs(Protocol):
    """The memory of a limited-memory BFGS solver for fields of one shape within bounds, on a device.

    It holds the last m steps s_j and gradient differences y_j, the direction, the step length and what it takes to
    decide without the host. `solvers/lbfgs.py` is the algorithm. Pixels have units of their own: with c the curvature
    that `begin` is given, x is measured in 1 / √c and the gradient in √c, in inner products and in the recursion.
    """

    go_on: Scalar  # 1 while there is something to do; then 0, or less as in `Residuals`

    def begin(self, x: Array, gradient: Array, value: Scalar, curvature: Array | None = None) -> None:
        """Forget everything; the first direction is against the gradient where the bounds leave it free.

        Its length is such that the root mean square of the first step, in those units, is `first_step`. `curvature`
        [y, x] > 0 is about the second derivative by each pixel, up to a factor; None is 1 everywhere.
        """

    def propose(self, x: Array, trial_out: Array) -> None:
        """trial = x + step * direction, moved into the bounds."""

    def judge(self, value: Scalar, trial_value: Scalar) -> None:
        """Accept the trial if trial_value <= value + 1e-4 * step * slope, the slope being gradient . direction.

        Accepted, `value` becomes `trial_value`, which is added to the trace, and `go_on` becomes 0 if the trace is flat
        (see `solvers/lbfgs.py`) or as long as it may be. Not accepted, the step shrinks to the minimum of the parabola
        through both values and the slope, but between 0.1 and 0.5 of what it was; `go_on` becomes 0 after 20 in a row.

        Where hosts look at `go_on` seldom (`repeat`), it accepts nothing once that is 0 or less, and takes 1 from it.
        """

    def learn(self, x: Array, gradient: Array, trial: Array, trial_gradient: Array) -> None:
        """Move to an accepted trial: keep s = trial - x and y = trial_gradient - gradient, if s . y is clearly positive
        (> 1e-10 |s| |y|), and let x and gradient become those of the trial. The next direction is that of the two-loop
        recursion (Nocedal 1980) on the gradient, with 0 where the bounds stop it, and its step is 1. A pixel at a bound
        that its gradient holds there does not move, whatever the recursion says.
        """

    def report(self) -> tuple[list[float], int, bool]:
        """Return the values accepted so far, the first included, the number of values judged plus 1, and whether they
        are flat; waits for the device."""


class Solvers(Protocol):
    """State of solvers from one iteration to the next."""

    def residuals(self, device: str, *, tolerance: float, most: int) -> Residuals:
        """Plan the bookkeeping of an iterative linear solver that makes at most `most` iterations."""

    def conjugate_step(
        self, p: Array, q: Array, preconditioner: Array, rz: Scalar, x: Array, r: Array, go_on: Scalar
    ) -> None:
        """Take a step of conjugate gradients for A x = b in place; all but `rz` and `go_on` are fields [y, x].

        p is the direction, q = A p, M the diagonal `preconditioner`, r = b - A x and rz = rᵀ M r. With α = rz / pᵀ q,
        x += α p and r -= α q. Then rz becomes rᵀ M r, and p becomes M r + β p with β the new rz over the old one. Where
        a denominator is 0, α or β is 0. Where `go_on` is not positive, α is 0: x and r stay. Inner products are
        accumulated in float64.
        """

    def lbfgs(
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
    ) -> Lbfgs:
        """Plan an L-BFGS memory of `memory` pairs for fields of `shape` [y, x]; `most` is the longest trace less 1.

        The trace is flat when its last `patience` steps together lowered the value by at most patience * tolerance *
        |first value|.
        """
