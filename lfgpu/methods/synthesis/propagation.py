"""Propagation: the gaps of the local estimate are filled from similar pixels nearby (paper §5)."""

import math
from collections.abc import Callable, Sequence

from lfgpu.contract import Array, Scalar
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.synthesis.config import PropagationConfig
from lfgpu.solvers.cg import ConjugateGradients
from lfgpu.solvers.lbfgsb import ScipyLbfgsb
from lfgpu.solvers.solution import Solution

_LEAST_DIAGONAL, _MOST_DIAGONAL = 1e-6, 1e30  # of the preconditioner: without a floor, weights may all be 0


class Propagation:
    """Finds argmin_m Σ_p Σ_{q∈N(p)} w_pq [(m_p - m_q)² + C_p (m0_p - m_q)²], with estimates m0 of coherence C.

    The normal equations are (2 L + diag(W C)) m = W (C m0). L is the Laplacian of the weights, and W sums over a
    neighbourhood with them. The minimum lies within the range of the defined m0.
    """

    def __init__(
        self, shape: Sequence[int], bounds: tuple[float, float], prior: NonLocalMeans, config: PropagationConfig
    ) -> None:
        kernels, device = prior.kernels, prior.device
        self._prior, self._kernels = prior, kernels
        tolerance, most = config.tolerance, config.max_iterations
        self._linear = ConjugateGradients(shape, device, tolerance=tolerance, max_iterations=most)
        self._by_gradient = None
        if config.solver == "lbfgsb":
            self._by_gradient = ScipyLbfgsb(shape, bounds, device, tolerance=tolerance, max_iterations=most)
        self._trust, self._target, self._workspace, self._inverse = (device.zeros(shape) for _ in range(4))
        self._mean, self._linear_part, self._constant = (device.scalar(0.0) for _ in range(3))
        self._tolerance = tolerance
        self.trusted = device.scalar(0.0)
        """Σ C, the sum of all coherences. If it is 0, there was no estimate and the filled map is meaningless."""
        self.filled = device.zeros(shape)
        """The filled map, a field [y, x], pixels per view step."""

    def run(self, disparity: Array, coherence: Array, callback: Callable[[int, float], None] | None = None) -> None:
        """Fill a map [y, x] where its coherence [y, x] is 0, and smooth it where its coherence is below 1."""
        k, prior, workspace, inverse = self._kernels, self._prior, self._workspace, self._inverse
        k.multiply(coherence, disparity, workspace)
        prior.neighbors(coherence, self._trust)
        prior.neighbors(workspace, self._target)
        k.dot(coherence, prior.ones, self.trusted)
        k.dot(workspace, prior.ones, self._mean)
        k.ratio(self._mean, self.trusted, self._mean)
        k.fill(self._mean, self.filled)
        k.select(coherence, disparity, self.filled, self.filled)
        k.multiply(workspace, disparity, workspace)
        k.dot(workspace, prior.degree, self._constant)
        k.axpby(2.0, prior.degree, 1.0, self._trust, inverse)
        k.axpby(1.0, inverse, -2.0, prior.ones, inverse)  # a pixel is not its own neighbour
        k.clamp(inverse, _LEAST_DIAGONAL, _MOST_DIAGONAL, inverse)
        if self._by_gradient is not None:
            k.divide(self._target, inverse, workspace)
            k.dot(self._target, workspace, self._linear_part)
            small = 2.0 * self._tolerance * math.sqrt(k.number(self._linear_part))  # the gradient is 2 (A m - b)
            self._by_gradient.minimize(self.energy, self.filled, callback, curvature=inverse, small=small)
            return
        k.divide(prior.ones, inverse, inverse)
        self._linear.solve(self._apply, self._target, inverse, self.filled, callback)

    def report(self) -> Solution:
        """Report the outcome of the solver in the last run; waits for the device."""
        return (self._by_gradient or self._linear).report()

    def _apply(self, m: Array, result_out: Array) -> None:
        """(2 L + diag(W C)) m"""
        self._prior.laplacian(m, result_out)
        self._kernels.multiply(self._trust, m, self._workspace)
        self._kernels.axpby(2.0, result_out, 1.0, self._workspace, result_out)

    def energy(self, m: Array, gradient_out: Array, value_out: Scalar) -> None:
        """Compute the energy of a map [y, x], mᵀ A m - 2 bᵀ m + Σ_p Σ_q w_pq C_p m0_p², and its gradient."""
        k = self._kernels
        self._apply(m, gradient_out)
        k.dot(m, gradient_out, value_out)
        k.dot(m, self._target, self._linear_part)
        k.axpby(1.0, value_out, -2.0, self._linear_part, value_out)
        k.axpby(1.0, value_out, 1.0, self._constant, value_out)
        k.axpby(2.0, gradient_out, -2.0, self._target, gradient_out)
