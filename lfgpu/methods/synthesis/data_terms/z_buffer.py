"""A data term with occlusions: a view shows the nearest of what lands on its pixels."""

from __future__ import annotations

from collections.abc import Sequence

from lfgpu.contract import Array, KernelSet, Scalar, SplatDataTerm

_SHARPNESS = 10.0  # view steps per pixel: what is half a pixel nearer counts 150 times as much
_LEAST_COVERAGE = 0.5  # a gap begins half a pixel after the last pixel before it


def plan(shape: Sequence[int], offsets: Array, *, softness: float, kernels: KernelSet, device: str) -> SplatDataTerm:
    """The squared error of the z-buffered splat, see `lfgpu.contract.Synthesis.z_buffered_data_term`."""
    return _ZBuffered(shape, offsets, softness, kernels)


class _ZBuffered:
    def __init__(self, shape: Sequence[int], offsets: Array, softness: float, kernels: KernelSet) -> None:
        self._term = kernels.z_buffered_data_term(
            shape,
            offsets,
            scale=1.0,
            softness=softness,
            sharpness=_SHARPNESS,
            least_coverage=_LEAST_COVERAGE,
            loss="squares",
            loss_scale=1.0,
        )
        # Where nothing is hidden both terms are the same function, and so is how it curves.
        self._plain = kernels.data_term(shape, offsets, scale=1.0, softness=softness)

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._term.load(image, recorded, valid)
        self._plain.load(image, recorded, valid)

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        self._term(disparity, gradient_out, value_out)

    def curvature(self, curvature_out: Array) -> None:
        self._plain.curvature(curvature_out)
