"""What a solver does with fields: NumPy, float64."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(a: Array, b: Array) -> float:
    return float(np.vdot(a, b))


def copy(source: Array, target_out: Array) -> None:
    target_out[:] = source


def axpby(alpha: float, x: Array, beta: float, y: Array, y_out: Array) -> None:
    y_out[:] = alpha * x + beta * y


def multiply(x: Array, y: Array, product_out: Array) -> None:
    product_out[:] = x * y


def clamp(x: Array, low: float, high: float, x_out: Array) -> None:
    x_out[:] = np.clip(x, low, high)
