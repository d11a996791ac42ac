"""Completion of an aligned map: depth edges where the colours have them, and surfaces without texture filled."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Array
from lfgpu.data.windows import window_min
from lfgpu.methods.matching.boundaries import Boundaries
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.hole_filling import HoleFilling


class Completion:
    """Boundary refinement, then hole filling.

    Parameters
    ----------
    frame
        The views.
    """

    def __init__(self, frame: Frame) -> None:
        arena, config, farthest, tuning = frame.arena, frame.config, frame.layout.farthest, frame.config.tuning
        self._kernels, self._image, self._bounds = frame.kernels, frame.image, frame.bounds
        self._boundaries = Boundaries(arena, config, frame.size, step=tuning.boundaries.step / farthest)
        self._filling = HoleFilling(arena, frame.size, frame.prior, config, support=tuning.alignment.support / farthest)
        self._alike = None
        if frame.known.mask is not None:
            # A patch that holds an unknown pixel is like no other patch: the pixel in its middle stays as it is.
            alike = window_min(frame.known.mask, tuning.prior.patch)
            self._alike = arena.constant("alike", alike)
            self._held = arena.constant("held", np.full(frame.size, self._filling.held))

    def run(self, aligned: Array, curvature: Array, disparity_out: Array) -> None:
        """Complete an aligned map [y, x] with the curvature [y, x] of the alignment, which may change."""
        self._boundaries.run(self._image, aligned, disparity_out)
        if self._alike is not None:
            self._kernels.select(self._alike, curvature, self._held, curvature)
        self._filling.run(disparity_out, curvature)
        self._kernels.clamp(disparity_out, *self._bounds, disparity_out)
