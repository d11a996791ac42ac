"""A data term with occlusions: each pixel of a view shows the nearest surface that is splatted onto it."""

from __future__ import annotations

from collections.abc import Sequence

from lfgpu.contract import Array, KernelSet, Scalar, SplatDataTerm

_SHARPNESS = 10.0  # view steps per pixel: a surface that is 0.5 px nearer has exp(5), about 150 times, the weight
_LEAST_COVERAGE = 0.5  # pixels with less coverage are gaps; a gap begins half a pixel beyond a surface


def plan(shape: Sequence[int], offsets: Array, *, softness: float, kernels: KernelSet) -> SplatDataTerm:
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
        # Without occlusions both terms are the same function, so the curvature of the additive one serves for both.
        self._plain = kernels.data_term(shape, offsets, scale=1.0, softness=softness)

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._term.load(image, recorded, valid)
        self._plain.load(image, recorded, valid)

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Scalar) -> None:
        self._term(disparity, gradient_out, value_out)

    def curvature(self, curvature_out: Array) -> None:
        self._plain.curvature(curvature_out)
