"""The kernel that spreads a pixel over its neighbours: a triangle, and the same with rounded kinks."""

import matplotlib.pyplot as plt
import numpy as np


def tent(a, softness):
    """The rounded triangle, as the reference backend has it."""
    a, s = np.abs(a), 1 / (1 - softness)
    line = 1 + s * (softness / 2 - a)
    top = 1 - s * a**2 / (2 * softness)
    foot = s * (1 - a) ** 2 / (2 * softness)
    inner = np.where(a <= softness, top, np.where(a >= 1 - softness, foot, line))
    return np.where(a < 1, inner, 0)


a = np.linspace(-1.2, 1.2, 500)
figure, axis = plt.subplots(figsize=(5, 2.2), layout="constrained")
axis.plot(a, np.maximum(1 - np.abs(a), 0), "--", color="0.6", label="triangle")
axis.plot(a, tent(a, 0.2), label="ε = 0.2")
axis.set_xlabel("distance, pixels")
axis.set_ylabel("Λ")
axis.legend()
