"""The paper's data term: each pixel of a view is the sum of everything that is splatted onto it."""

from __future__ import annotations

from collections.abc import Sequence

from lfgpu.contract import Array, KernelSet, SplatDataTerm


def plan(shape: Sequence[int], offsets: Array, *, softness: float, kernels: KernelSet) -> SplatDataTerm:
    """The squared error of the additive splat, see `lfgpu.contract.Synthesis.data_term`."""
    return kernels.data_term(shape, offsets, scale=1.0, softness=softness)
