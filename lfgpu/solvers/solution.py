"""What a solver returns."""

from __future__ import annotations

from dataclasses import dataclass

from lfgpu.types import Float32Array


@dataclass(frozen=True, eq=False)
class Solution:
    """A minimum, or how near a solver came.

    Parameters
    ----------
    values
        The map, float32 [y, x].
    converged
        Whether the tolerance was met.
    status
        Why it stopped, as a sentence.
    iterations, evaluations
        How many were needed.
    trace
        What was reported after each iteration: the energy, or for linear systems the relative residual.
    """

    values: Float32Array
    converged: bool
    status: str
    iterations: int
    evaluations: int
    trace: tuple[float, ...]
