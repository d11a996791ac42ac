"""Completion of an aligned map: depth edges where the colours have them, and surfaces without texture filled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfgpu.contract import Array, Scalar, half_window
from lfgpu.data.windows import window_min
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.config import HoleFillingConfig
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.tuning import BoundariesTuning
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.solvers.cg import ConjugateGradients


class Boundaries:
    """Two passes over the pixels at depth edges, differences of a `step`: blurred outlines run through two pixels."""

    def __init__(
        self,
        arena: Arena,
        tuning: BoundariesTuning,
        size: tuple[int, int],
        *,
        step: float,
        contrast: Callable[[], float],
    ) -> None:
        self._kernels, self._step = arena.kernels, step
        self._first = tuning.share, arena.number(contrast)
        second = arena.number(lambda: tuning.second_contrast * contrast())
        self._second = tuning.second_share * tuning.share, second
        with arena.scratch() as scratch:
            self._once = scratch.field(size)

    def run(self, image: Array, disparity: Array, disparity_out: Array) -> None:
        """Give each pixel of a map [y, x] at a depth edge to the side whose colour it has in an image [y, x, c]."""
        self._pass(image, disparity, self._first, self._once)
        self._pass(image, self._once, self._second, disparity_out)

    def _pass(self, image: Array, disparity: Array, limits: tuple[float, float | Scalar], disparity_out: Array) -> None:
        share, contrast = limits
        self._kernels.refine_boundaries(
            image, disparity, step=self._step, contrast=contrast, share=share, disparity_out=disparity_out
        )


def depth_step(frame: Frame, bounds: tuple[float, float]) -> float:
    """Return the difference between adjacent pixels beyond which they lie at a depth edge, pixels per view step.

    It is `boundaries.step` in the farthest view; in wide ranges more, or turned surfaces would consist of depth edges.
    """
    tuning, (low, high) = frame.config.tuning.boundaries, bounds
    return max(tuning.step / frame.reach, (high - low) / tuning.turned)


_LEAST, _MOST = 1e-5, 1e3  # range of a pixel's own weight, in units of the weights between pixels


class HoleFilling:
    """argmin_m Σ_p c_p (m_p - d_p)² + Σ_pq v_pq (m_p - m_q)² for a map d with certainties c.

    v are the weights of pixels that look alike and lie on one surface of d, each pair counted once; a difference of
    `support` pixels per view step halves them. Where a window has texture, c outweighs them and nothing moves. Where it
    has none, the minimum is the smoothest surface that continues what is around: between the outlines of a plane, a
    plane.
    """

    def __init__(
        self,
        arena: Arena,
        size: tuple[int, int],
        prior: NonLocalMeans,
        config: HoleFillingConfig,
        *,
        support: float,
        held: Callable[[], float],
        tolerance: float,
        keeps_prior: bool,
    ) -> None:
        self._prior, self._kernels, self._support = prior, arena.kernels, support
        self._per_held = arena.number(lambda: 1 / held())
        shape = len(half_window(prior.window)), *size
        self._weights = arena.field("weights on surfaces", shape) if keeps_prior else prior.weights
        self._certainty, self._target, self._inverse = (
            arena.field(f"hole filling, {name}", size) for name in ("certainty", "target", "inverse")
        )
        self._solver = ConjugateGradients(
            size,
            arena.device,
            tolerance=tolerance,
            max_iterations=config.max_iterations,
        )

    def run(self, disparity: Array, curvature: Array) -> None:
        """Improve a map [y, x] in place; `curvature` [y, x] is that of the alignment."""
        k, prior, ones = self._kernels, self._prior, self._prior.ones
        k.axpby(self._per_held, curvature, 0.0, curvature, self._certainty)
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


class Completion:
    """Boundary refinement, then hole filling, which unless `keeps_prior` overwrites the weights of like pixels."""

    def __init__(self, frame: Frame, *, keeps_prior: bool) -> None:
        arena, config, farthest, tuning = frame.arena, frame.config, frame.layout.farthest, frame.config.tuning
        self._kernels, self._image, self._bounds = frame.kernels, frame.image, (frame.low, frame.high)
        self._prior, self._keeps_prior = frame.prior, keeps_prior
        step = depth_step(frame, frame.bounds)
        frame.fits.append(lambda bounds: depth_step(frame, bounds) == step)
        self._boundaries = Boundaries(
            arena,
            tuning.boundaries,
            frame.size,
            step=step,
            contrast=lambda: frame.config.boundaries.contrast,
        )

        def held() -> float:
            """Return the curvature at which a pixel's own estimate counts as much as one similar neighbour."""
            return tuning.hole_filling.stiffness * frame.config.tuning.alignment.robust**2

        self._filling = HoleFilling(
            arena,
            frame.size,
            frame.prior,
            config.hole_filling,
            support=tuning.alignment.support / farthest,
            held=held,
            tolerance=tuning.hole_filling.tolerance,
            keeps_prior=keeps_prior,
        )
        self._alike = None
        if frame.known.mask is not None:
            # A patch that holds an unknown pixel is like no other patch: the pixel in its middle stays as it is.
            alike = window_min(frame.known.mask, tuning.prior.patch)
            self._alike = arena.constant("alike", alike)
            self._held = arena.constant("held", np.full(frame.size, held()))

    def run(self, aligned: Array, curvature: Array, disparity_out: Array) -> None:
        """Complete an aligned map [y, x] with the curvature [y, x] of the alignment, which may change."""
        self._boundaries.run(self._image, aligned, disparity_out)
        self.fill(disparity_out, curvature)

    def restore_prior(self) -> None:
        """Compute the weights of like pixels again if a filling has overwritten them."""
        if not self._keeps_prior:
            self._prior.load(self._image)

    def fill(self, disparity: Array, curvature: Array) -> None:
        """Fill the surfaces without texture of a map [y, x] in place; the curvature [y, x] may change."""
        if self._alike is not None:
            self._kernels.select(self._alike, curvature, self._held, curvature)
        self._filling.run(disparity, curvature)
        self._kernels.clamp(disparity, *self._bounds, disparity)
