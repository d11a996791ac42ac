"""Vector operations of solvers: NumPy, float64. A number is an array of shape [1]."""

import numpy as np

from lfgpu.contract import Float64Array as Array

Coefficient = float | Array


def dot(a: Array, b: Array, product_out: Array) -> None:
    product_out[0] = np.vdot(a, b)


def ratio(numerator: Array, denominator: Array, ratio_out: Array, *, factor: float = 1.0) -> None:
    ratio_out[0] = factor * numerator[0] / denominator[0] if denominator[0] != 0 else 0.0


def copy(source: Array, target_out: Array) -> None:
    target_out[:] = source


def axpby(alpha: Coefficient, x: Array, beta: Coefficient, y: Array, y_out: Array) -> None:
    y_out[:] = alpha * x + beta * y


def multiply(x: Array, y: Array, product_out: Array) -> None:
    product_out[:] = x * y


def divide(x: Array, y: Array, quotient_out: Array) -> None:
    quotient_out[:] = np.where(y == 0, 0.0, x / np.where(y == 0, 1.0, y))


def fill(value: Coefficient, x_out: Array) -> None:
    x_out[:] = value


def select(condition: Array, x: Array, y: Array, chosen_out: Array) -> None:
    chosen_out[:] = np.where(condition > 0, x, y)


def threshold(x: Array, threshold: float, x_out: Array) -> None:
    x_out[:] = np.where(x >= threshold, x, 0.0)


def clamp(x: Array, low: float, high: float, x_out: Array) -> None:
    x_out[:] = np.clip(x, low, high)
