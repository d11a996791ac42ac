"""The differentiable tent Λ on the device; `kernels/reference/tent.py` says what it is."""

import warp as wp


@wp.func
def tent(a: float, softness: float) -> float:
    """Λ(a) for a in [0, 1], as 1 minus the integral of -Λ': without branches, which random fractions mispredict."""
    top = wp.min(a, softness)
    foot = wp.max(a - (1.0 - softness), 0.0)
    return 1.0 - (a - top + (top * top - foot * foot) * (0.5 / softness)) * (1.0 / (1.0 - softness))


@wp.func
def tent_slope(a: float, softness: float) -> float:
    """Λ'(a) for a in [0, 1]."""
    return -(1.0 / (1.0 - softness)) * wp.min(wp.min(a, 1.0 - a) * (1.0 / softness), 1.0)


@wp.func
def foot(b: float, softness: float) -> float:
    """Λ(1 - b) for b in [0, 1], with all its digits where it is nearly 0."""
    low = wp.min(b, softness)
    top = wp.max(b - (1.0 - softness), 0.0)
    return (b - low + (low * low - top * top) * (0.5 / softness)) * (1.0 / (1.0 - softness))
