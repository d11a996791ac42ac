"""The outcome of an iterative solver."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Solution:
    """The outcome of an iterative solver. The solution itself stays on the device.

    Parameters
    ----------
    converged
        Whether the tolerance was met.
    status
        Why it stopped, as a sentence.
    iterations, evaluations
        Numbers of iterations and of function evaluations.
    trace
        The energy, or for linear systems the relative residual, at the start and after each iteration.
    """

    converged: bool
    status: str
    iterations: int
    evaluations: int
    trace: tuple[float, ...]
