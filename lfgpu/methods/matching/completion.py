"""Completion of an aligned map: depth edges where the colours have them, and surfaces without texture filled."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Array, half_window
from lfgpu.data.windows import window_min
from lfgpu.methods.matching.frame import Frame
from lfgpu.solvers.cg import ConjugateGradients

_LEAST, _MOST = 1e-5, 1e3  # range of a pixel's own weight, in units of the weights between pixels


def depth_step(frame: Frame, bounds: tuple[float, float]) -> float:
    """Return the difference between adjacent pixels beyond which they lie at a depth edge, pixels per view step.

    It is `boundaries.step` in the farthest view; in wide ranges more, or turned surfaces would consist of depth edges.
    """
    tuning, (low, high) = frame.config.tuning.boundaries, bounds
    return max(tuning.step / frame.reach, (high - low) / tuning.turned)


class Completion:
    """Boundary refinement, then hole filling, which unless `keeps_prior` overwrites the weights of like pixels.

    Boundaries are refined in two passes over the pixels at depth edges: blurred outlines run through two pixels.

    Holes are filled by argmin_m Σ_p c_p (m_p - d_p)² + Σ_pq v_pq (m_p - m_q)² for a map d with certainties c. v are the
    weights of pixels that look alike and lie on one surface of d, each pair counted once; a difference of the
    alignment's `support` halves them. Where a window has texture, c outweighs them and nothing moves. Where it has
    none, the minimum is the smoothest surface that continues what is around: between the outlines of a plane, a plane.
    """

    def __init__(self, frame: Frame, *, keeps_prior: bool) -> None:
        arena, size, tuning = frame.arena, frame.size, frame.config.tuning
        self._kernels, self._image, self._bounds = frame.kernels, frame.image, (frame.low, frame.high)
        self._prior, self._keeps_prior = frame.prior, keeps_prior
        self._step = step = depth_step(frame, frame.bounds)
        frame.fits.append(lambda bounds: depth_step(frame, bounds) == step)
        edges = tuning.boundaries
        self._first = edges.share, arena.number(lambda: frame.config.boundaries.contrast)
        second = arena.number(lambda: edges.second_contrast * frame.config.boundaries.contrast)
        self._second = edges.second_share * edges.share, second
        with arena.scratch() as scratch:
            self._once = scratch.field(size)

        def held() -> float:
            """Return the curvature at which a pixel's own estimate counts as much as one similar neighbour."""
            return tuning.hole_filling.stiffness * frame.config.tuning.alignment.robust**2

        self._support = tuning.alignment.support / frame.layout.farthest
        self._per_held = arena.number(lambda: 1 / held())
        shape = len(half_window(frame.prior.window)), *size
        self._weights = arena.field("weights on surfaces", shape) if keeps_prior else frame.prior.weights
        self._certainty, self._target, self._inverse = (
            arena.field(f"hole filling, {name}", size) for name in ("certainty", "target", "inverse")
        )
        most, tolerance = frame.config.hole_filling.max_iterations, tuning.hole_filling.tolerance
        self._solver = ConjugateGradients(size, arena.device, tolerance=tolerance, max_iterations=most)
        self._alike = None
        if frame.known.shown is not None:
            # A patch that holds an unknown pixel is like no other patch: the pixel in its middle stays as it is.
            alike = window_min(frame.known.shown, tuning.prior.patch)
            self._alike = arena.constant("alike", alike)
            self._held = arena.constant("held", np.full(size, held()))

    def run(self, aligned: Array, curvature: Array, disparity_out: Array) -> None:
        """Complete an aligned map [y, x] with the curvature [y, x] of the alignment, which may change."""
        passes = (aligned, self._first, self._once), (self._once, self._second, disparity_out)
        for before, (share, contrast), after in passes:
            self._kernels.refine_boundaries(
                self._image, before, step=self._step, contrast=contrast, share=share, disparity_out=after
            )
        self.fill(disparity_out, curvature)

    def restore_prior(self) -> None:
        """Compute the weights of like pixels again if a filling has overwritten them."""
        if not self._keeps_prior:
            self._prior.load(self._image)

    def fill(self, disparity: Array, curvature: Array) -> None:
        """Fill the surfaces without texture of a map [y, x] in place; the curvature [y, x] may change."""
        k, prior, ones, inverse = self._kernels, self._prior, self._prior.ones, self._inverse
        if self._alike is not None:
            k.select(self._alike, curvature, self._held, curvature)
        k.axpby(self._per_held, curvature, 0.0, curvature, self._certainty)
        k.clamp(self._certainty, _LEAST, _MOST, self._certainty)
        k.nlm_on_surface(
            prior.weights, disparity, window=prior.window, support=self._support, weights_out=self._weights
        )
        k.nlm_neighbors(self._weights, ones, window=prior.window, sums_out=inverse)
        k.axpby(1.0, inverse, -1.0, ones, inverse)  # a pixel is not its own neighbour
        k.axpby(1.0, inverse, 1.0, self._certainty, inverse)
        k.divide(ones, inverse, inverse)
        k.multiply(self._certainty, disparity, self._target)
        self._solver.solve(self._apply, self._target, inverse, disparity)
        k.clamp(disparity, *self._bounds, disparity)

    def _apply(self, m: Array, result_out: Array) -> None:
        """(L + diag(c)) m"""
        window = self._prior.window
        self._kernels.nlm_laplacian(self._weights, m, window=window, laplacian_out=result_out, diagonal=self._certainty)
