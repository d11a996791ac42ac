"""Hole filling: surfaces without texture continue those around them."""

from __future__ import annotations

from lfgpu.contract import Array, half_window
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.solvers.cg import ConjugateGradients

_LEAST, _MOST = 1e-5, 1e3  # range of a pixel's own weight, in units of the weights between pixels


class HoleFilling:
    """argmin_m Σ_p c_p (m_p - d_p)² + Σ_pq v_pq (m_p - m_q)² for a map d with certainties c.

    v are the weights of pixels that look alike and lie on one surface of d, each pair counted once. Where a window has
    texture, c outweighs them and nothing moves. Where it has none, the minimum is the smoothest surface that continues
    what is around: between the outlines of a plane, a plane.

    Parameters
    ----------
    arena
        Where buffers come from.
    size
        (height, width) of the map.
    prior
        The weights of like pixels.
    config
        The limits of the solver, and the numbers of the tuning.
    support
        The difference in disparity that halves the weight of a neighbour, pixels per view step.
    """

    def __init__(
        self, arena: Arena, size: tuple[int, int], prior: NonLocalMeans, config: MatchingConfig, *, support: float
    ) -> None:
        tuning = config.tuning
        self._prior, self._kernels, self._support = prior, arena.kernels, support
        self.held = tuning.hole_filling.stiffness * tuning.alignment.robust**2
        """The curvature at which a pixel's own estimate counts as much as one similar neighbour."""
        self._weights = arena.field("weights on surfaces", (len(half_window(prior.window)), *size))
        self._certainty, self._target, self._inverse = (
            arena.field(f"hole filling, {name}", size) for name in ("certainty", "target", "inverse")
        )
        self._solver = ConjugateGradients(
            size,
            arena.device,
            tolerance=tuning.hole_filling.tolerance,
            max_iterations=config.hole_filling.max_iterations,
        )

    def run(self, disparity: Array, curvature: Array) -> None:
        """Improve a map [y, x] in place; `curvature` [y, x] is that of the alignment."""
        k, prior, ones = self._kernels, self._prior, self._prior.ones
        k.axpby(1 / self.held, curvature, 0.0, curvature, self._certainty)
        k.clamp(self._certainty, _LEAST, _MOST, self._certainty)
        k.nlm_on_surface(
            prior.weights, disparity, window=prior.window, support=self._support, weights_out=self._weights
        )
        k.nlm_neighbors(self._weights, ones, window=prior.window, sums_out=self._inverse)
        k.axpby(1.0, self._inverse, -1.0, ones, self._inverse)  # a pixel is not its own neighbour
        k.axpby(1.0, self._inverse, 1.0, self._certainty, self._inverse)
        k.divide(ones, self._inverse, self._inverse)
        k.multiply(self._certainty, disparity, self._target)
        self._solver.solve(self._apply, self._target, self._inverse, disparity)

    def _apply(self, m: Array, result_out: Array) -> None:
        """(L + diag(c)) m"""
        window = self._prior.window
        self._kernels.nlm_laplacian(self._weights, m, window=window, laplacian_out=result_out, diagonal=self._certainty)
