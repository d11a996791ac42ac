"""The outcome of an iterative solver."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Solution:
    """The outcome of an iterative solver. The solution itself stays on the device."""

    converged: bool  # True if the tolerance was met
    status: str  # why it stopped, as a sentence
    iterations: int
    evaluations: int
    trace: tuple[float, ...]  # energy or relative residual, at the start and after each iteration
