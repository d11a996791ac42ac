"""Depth edges: pixels that show so little of the nearer surface that they belong to the farther one."""

from __future__ import annotations

from lfgpu.contract import Array
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.config import MatchingConfig


class Boundaries:
    """Two passes over the pixels at depth edges: blurred outlines run through two pixels.

    Parameters
    ----------
    arena
        Where buffers come from.
    config
        `boundaries.contrast`, and the numbers of the tuning.
    size
        (height, width) of the map.
    step
        The difference in disparity of a depth edge, pixels per view step.
    """

    def __init__(self, arena: Arena, config: MatchingConfig, size: tuple[int, int], *, step: float) -> None:
        tuning, contrast = config.tuning.boundaries, config.boundaries.contrast
        self._kernels, self._step = arena.kernels, step
        self._first = tuning.share, contrast
        self._second = tuning.second_share * tuning.share, tuning.second_contrast * contrast
        with arena.scratch() as scratch:
            self._once = scratch.field(size)

    def run(self, image: Array, disparity: Array, disparity_out: Array) -> None:
        """Give each pixel of a map [y, x] at a depth edge to the side whose colour it has in an image [y, x, c]."""
        self._pass(image, disparity, self._first, self._once)
        self._pass(image, self._once, self._second, disparity_out)

    def _pass(self, image: Array, disparity: Array, limits: tuple[float, float], disparity_out: Array) -> None:
        share, contrast = limits
        self._kernels.refine_boundaries(
            image, disparity, step=self._step, contrast=contrast, share=share, disparity_out=disparity_out
        )
