"""The paper's data term: a view is the sum of all that lands on its pixels."""

from __future__ import annotations

from collections.abc import Sequence

from lfgpu.contract import Array, KernelSet, SplatDataTerm


def plan(shape: Sequence[int], offsets: Array, *, softness: float, kernels: KernelSet, device: str) -> SplatDataTerm:
    """The squared error of the plain splat, see `lfgpu.contract.Synthesis.data_term`."""
    return kernels.data_term(shape, offsets, scale=1.0, softness=softness)
