"""The differentiable tent Λ: a triangle of support [-1, 1] with its three kinks rounded over a width ε.

C¹, and Λ(a) + Λ(1 - a) = 1, so that what a pixel gives to its two neighbours always adds up to 1. With s = 1/(1 - ε):
1 - s a²/(2ε) up to ε, s (1 - a)²/(2ε) from 1 - ε on, and a line of slope -s between. ε → 0 is the triangle.
"""

import numpy as np
from numpy.typing import NDArray


def tent(a: NDArray[np.float64], softness: float) -> NDArray[np.float64]:
    """Λ(a) for a in [0, 1]; `softness` is ε in (0, 0.5]."""
    s = 1.0 / (1.0 - softness)
    line = 1.0 + s * (0.5 * softness - a)
    top = 1.0 - s * a**2 / (2.0 * softness)
    foot = s * (1.0 - a) ** 2 / (2.0 * softness)
    return np.where(a <= softness, top, np.where(a >= 1.0 - softness, foot, line))


def tent_slope(a: NDArray[np.float64], softness: float) -> NDArray[np.float64]:
    """Λ'(a) for a in [0, 1]."""
    s = 1.0 / (1.0 - softness)
    return -s * np.minimum(np.minimum(a, 1.0 - a) / softness, 1.0)
