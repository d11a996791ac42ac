"""What a step of the alignment asks of the views: which of them see a pixel, and how well these agree."""

from __future__ import annotations

from collections.abc import Sequence

from lfgpu.contract import Array, KernelSet
from lfgpu.methods.matching.config import AlignmentConfig


class AlignmentStep:
    """A step on views of `shape` [n, y, x, c] with `offsets` [n, 2].

    Parameters
    ----------
    nearest
        Workspace [n, y, x].
    scale
        The factor from stored values to intensities.
    tolerance
        What is nearer by less hides nothing, pixels per view step.
    """

    def __init__(
        self,
        shape: Sequence[int],
        offsets: Array,
        nearest: Array,
        kernels: KernelSet,
        *,
        scale: float,
        config: AlignmentConfig,
        tolerance: float,
    ) -> None:
        # Beside an edge in another view, what is seen there is mixed with what is nearer: one pixel is left out.
        self._hiding_beside, self._nearest = kernels.z_buffer(shape, offsets, reach=1), nearest
        self._align = kernels.alignment(
            shape,
            offsets,
            scale=scale,
            gradient_weight=config.gradient_weight,
            contrast=config.contrast,
            robust=config.robust,
            tolerance=tolerance,
        )

    def load(self, image: Array, views: Array, valid: Array | None) -> None:
        """Take the reference image [y, x, c] and the views [n, y, x, c], as stored, with their masks [n, y, x]."""
        self._align.load(image, views, valid)

    def __call__(self, map_: Array, curvature_out: Array, slope_out: Array) -> None:
        """Curvature and slope [y, x] of how the views differ at a map [y, x]."""
        self._hiding_beside(map_, self._nearest)
        self._align(map_, self._nearest, curvature_out, slope_out)
