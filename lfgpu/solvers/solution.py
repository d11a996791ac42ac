"""What a solver says when it is done."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Solution:
    """How a solver got to its minimum, or how near it came; the minimum itself stays on the device.

    Parameters
    ----------
    converged
        Whether the tolerance was met.
    status
        Why it stopped, as a sentence.
    iterations, evaluations
        How many were needed.
    trace
        What was left at the start and after each iteration: the energy, or for linear systems the relative residual.
    """

    converged: bool
    status: str
    iterations: int
    evaluations: int
    trace: tuple[float, ...]
