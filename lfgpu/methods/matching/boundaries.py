"""Depth edges: which pixels show so little of what is nearer that they belong to what is behind."""

from __future__ import annotations

from lfgpu.contract import Array, KernelSet
from lfgpu.methods.matching.config import BoundariesConfig

# Blurred outlines run through two pixels. Of the second one, only what is clear counts.
_SHARE_AGAIN, _CONTRAST_AGAIN = 0.6, 4.0  # over those of the first one


class Boundaries:
    """Two passes over the pixels at depth edges: the second one decides those that the first one laid bare.

    Parameters
    ----------
    kernels
        Where it is computed.
    config
        How little of a colour is little.
    step
        The difference in disparity of a depth edge, pixels per view step.
    workspace
        Of the map's size [y, x]; nothing is kept in it between two runs.
    """

    def __init__(self, kernels: KernelSet, config: BoundariesConfig, *, step: float, workspace: Array) -> None:
        self._kernels, self._config, self._step, self._once = kernels, config, step, workspace

    def run(self, image: Array, disparity: Array, disparity_out: Array) -> None:
        """From a map [y, x] and the reference image [y, x, c] to a map whose edges are where the colours have them."""
        share, contrast = self._config.share, self._config.contrast
        self._pass(image, disparity, share, contrast, self._once)
        self._pass(image, self._once, _SHARE_AGAIN * share, _CONTRAST_AGAIN * contrast, disparity_out)

    def _pass(self, image: Array, disparity: Array, share: float, contrast: float, disparity_out: Array) -> None:
        self._kernels.refine_boundaries(
            image, disparity, step=self._step, contrast=contrast, share=share, disparity_out=disparity_out
        )
