"""Vector operations of solvers, on the device."""

from types import SimpleNamespace
from typing import Any

import taichi as ti

from .memory import DeviceArray, flat, one, operation
from .runtime import double, once, run


@once
def _linear_kernels(kind: Any) -> SimpleNamespace:
    """Kernels of both fields (float32) and scalars (float64)."""
    real = double()
    array, scalar = flat(kind), flat(real)

    @ti.func
    def coefficient(number: real, scalar: ti.template()):
        """Multiply a number by a scalar, one of which is 1."""
        return ti.cast(number * scalar[0], kind)

    @ti.kernel
    def copy_kernel(source: array, target_out: array):
        for i in range(source.shape[0]):
            target_out[i] = source[i]

    @ti.kernel
    def axpby_kernel(
        alpha: real, alpha_scalar: scalar, x: array, beta: real, beta_scalar: scalar, y: array, y_out: array
    ):
        for i in range(x.shape[0]):
            y_out[i] = coefficient(alpha, alpha_scalar) * x[i] + coefficient(beta, beta_scalar) * y[i]

    @ti.kernel
    def fill_kernel(value: real, value_scalar: scalar, x_out: array):
        for i in range(x_out.shape[0]):
            x_out[i] = coefficient(value, value_scalar)

    return SimpleNamespace(copy=copy_kernel, axpby=axpby_kernel, fill=fill_kernel)


@once
def _ratio_kernel() -> Any:
    real = double()
    scalar = flat(real)

    @ti.kernel
    def ratio_kernel(numerator: scalar, denominator: scalar, factor: real, ratio_out: scalar):
        quotient = ti.cast(0.0, real)
        if denominator[0] != 0.0:
            quotient = factor * numerator[0] / denominator[0]
        ratio_out[0] = quotient

    return ratio_kernel


def ratio(numerator: DeviceArray, denominator: DeviceArray, ratio_out: DeviceArray, *, factor: float = 1.0) -> None:
    run(_ratio_kernel(), numerator, denominator, factor, ratio_out)


@operation
@ti.kernel
def multiply(x: flat(), y: flat(), product_out: flat()):
    for i in range(x.shape[0]):
        product_out[i] = x[i] * y[i]


@operation
@ti.kernel
def divide(x: flat(), y: flat(), quotient_out: flat()):
    for i in range(x.shape[0]):
        quotient = 0.0
        if y[i] != 0.0:
            quotient = x[i] / y[i]
        quotient_out[i] = quotient


@operation
@ti.kernel
def select(condition: flat(), x: flat(), y: flat(), chosen_out: flat()):
    for i in range(x.shape[0]):
        chosen = y[i]
        if condition[i] > 0.0:
            chosen = x[i]
        chosen_out[i] = chosen


@operation
@ti.kernel
def threshold(x: flat(), threshold: float, x_out: flat()):
    for i in range(x.shape[0]):
        value = 0.0
        if x[i] >= threshold:
            value = x[i]
        x_out[i] = value


@operation
@ti.kernel
def clamp(x: flat(), low: float, high: float, x_out: flat()):
    for i in range(x.shape[0]):
        x_out[i] = ti.math.clamp(x[i], low, high)


def copy(source: DeviceArray, target_out: DeviceArray) -> None:
    run(_linear_kernels(source.scalar).copy, source, target_out)


def axpby(
    alpha: float | DeviceArray, x: DeviceArray, beta: float | DeviceArray, y: DeviceArray, y_out: DeviceArray
) -> None:
    run(_linear_kernels(y_out.scalar).axpby, *_coefficient(alpha), x, *_coefficient(beta), y, y_out)


def fill(value: float | DeviceArray, x_out: DeviceArray) -> None:
    run(_linear_kernels(x_out.scalar).fill, *_coefficient(value), x_out)


def _coefficient(value: float | DeviceArray) -> tuple[float, DeviceArray]:
    """Split a value into a number and a scalar, whose product the value is."""
    return (1.0, value) if isinstance(value, DeviceArray) else (value, one())
