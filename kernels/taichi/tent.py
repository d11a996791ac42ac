"""The differentiable tent Λ on the device; `kernels/reference/splat.py` says what it is."""

import taichi as ti


@ti.func
def tent(a, softness):
    """Λ(a) for a in [0, 1], as 1 minus the integral of -Λ': without branches, which random fractions mispredict."""
    top = ti.min(a, softness)
    foot = ti.max(a - (1.0 - softness), 0.0)
    return 1.0 - (a - top + (top * top - foot * foot) * (0.5 / softness)) * (1.0 / (1.0 - softness))


@ti.func
def tent_slope(a, softness):
    """Λ'(a) for a in [0, 1]."""
    return -(1.0 / (1.0 - softness)) * ti.min(ti.min(a, 1.0 - a) * (1.0 / softness), 1.0)


@ti.func
def foot(b, softness):
    """Λ(1 - b) for b in [0, 1], with all its digits where it is nearly 0."""
    low = ti.min(b, softness)
    top = ti.max(b - (1.0 - softness), 0.0)
    return (b - low + (low * low - top * top) * (0.5 / softness)) * (1.0 / (1.0 - softness))
