"""Surfaces without texture: what the pixels that show something say about those that look like them and do not."""

from __future__ import annotations

from lfgpu.contract import Array, half_window
from lfgpu.methods.matching.config import HoleFillingConfig
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.solvers.cg import ConjugateGradients

_LEAST, _MOST = 1e-5, 1e3  # in units of the weights between pixels: what a pixel's own estimate counts


class HoleFilling:
    """argmin_m Σ_p c_p (m_p - d_p)² + Σ_pq v_pq (m_p - m_q)² for a map d with certainties c.

    v are the weights of pixels that look alike and lie on one surface of d, each pair counted once. Where a window has
    texture c outweighs them and nothing moves; where it has none the minimum is the smoothest surface that goes on from
    what is around, a plane between the outlines of a plane.

    Parameters
    ----------
    size
        (height, width) of the map.
    prior
        The weights by likeness.
    config
        How much curvature makes a pixel stay, and the solver's limits.
    """

    def __init__(self, size: tuple[int, int], prior: NonLocalMeans, config: HoleFillingConfig) -> None:
        kernels, device = prior.kernels, prior.device
        self._prior, self._kernels, self._config = prior, kernels, config
        self._weights = device.zeros((len(half_window(prior.window)), *size))
        self._certainty, self._target, self._inverse = (device.zeros(size) for _ in range(3))
        self._solver = ConjugateGradients(
            size, device, tolerance=config.tolerance, max_iterations=config.max_iterations
        )

    def run(self, disparity: Array, curvature: Array, *, noise: float, support: float) -> None:
        """Improve a map [y, x] in place.

        `curvature` [y, x] is that of the alignment and `noise` the square of what is taken for noise there; `support`
        is the difference in disparity that halves the weight of a neighbour.
        """
        k, prior, ones = self._kernels, self._prior, self._prior.ones
        k.axpby(1 / (self._config.stiffness * noise), curvature, 0.0, curvature, self._certainty)
        k.clamp(self._certainty, _LEAST, _MOST, self._certainty)
        k.nlm_on_surface(prior.weights, disparity, window=prior.window, support=support, weights_out=self._weights)
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
