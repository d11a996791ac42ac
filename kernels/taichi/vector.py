"""Vector operations of solvers, on the device."""

from types import SimpleNamespace
from typing import Any

import taichi as ti

from .memory import DeviceArray, flat, one
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
def _kernels() -> SimpleNamespace:
    real = double()
    field, scalar = flat(), flat(real)

    @ti.kernel
    def multiply_kernel(x: field, y: field, product_out: field):
        for i in range(x.shape[0]):
            product_out[i] = x[i] * y[i]

    @ti.kernel
    def divide_kernel(x: field, y: field, quotient_out: field):
        for i in range(x.shape[0]):
            quotient = 0.0
            if y[i] != 0.0:
                quotient = x[i] / y[i]
            quotient_out[i] = quotient

    @ti.kernel
    def select_kernel(condition: field, x: field, y: field, chosen_out: field):
        for i in range(x.shape[0]):
            chosen = y[i]
            if condition[i] > 0.0:
                chosen = x[i]
            chosen_out[i] = chosen

    @ti.kernel
    def threshold_kernel(x: field, threshold: float, x_out: field):
        for i in range(x.shape[0]):
            value = 0.0
            if x[i] >= threshold:
                value = x[i]
            x_out[i] = value

    @ti.kernel
    def clamp_kernel(x: field, low: float, high: float, x_out: field):
        for i in range(x.shape[0]):
            x_out[i] = ti.math.clamp(x[i], low, high)

    @ti.kernel
    def ratio_kernel(numerator: scalar, denominator: scalar, factor: real, ratio_out: scalar):
        quotient = ti.cast(0.0, real)
        if denominator[0] != 0.0:
            quotient = factor * numerator[0] / denominator[0]
        ratio_out[0] = quotient

    return SimpleNamespace(
        multiply=multiply_kernel,
        divide=divide_kernel,
        select=select_kernel,
        threshold=threshold_kernel,
        clamp=clamp_kernel,
        ratio=ratio_kernel,
    )


def ratio(numerator: DeviceArray, denominator: DeviceArray, ratio_out: DeviceArray, *, factor: float = 1.0) -> None:
    run(_kernels().ratio, numerator, denominator, factor, ratio_out)


def copy(source: DeviceArray, target_out: DeviceArray) -> None:
    run(_linear_kernels(source.scalar).copy, source, target_out)


def axpby(
    alpha: float | DeviceArray, x: DeviceArray, beta: float | DeviceArray, y: DeviceArray, y_out: DeviceArray
) -> None:
    run(_linear_kernels(y_out.scalar).axpby, *_coefficient(alpha), x, *_coefficient(beta), y, y_out)


def multiply(x: DeviceArray, y: DeviceArray, product_out: DeviceArray) -> None:
    run(_kernels().multiply, x, y, product_out)


def divide(x: DeviceArray, y: DeviceArray, quotient_out: DeviceArray) -> None:
    run(_kernels().divide, x, y, quotient_out)


def fill(value: float | DeviceArray, x_out: DeviceArray) -> None:
    run(_linear_kernels(x_out.scalar).fill, *_coefficient(value), x_out)


def select(condition: DeviceArray, x: DeviceArray, y: DeviceArray, chosen_out: DeviceArray) -> None:
    run(_kernels().select, condition, x, y, chosen_out)


def threshold(x: DeviceArray, threshold: float, x_out: DeviceArray) -> None:
    run(_kernels().threshold, x, threshold, x_out)


def clamp(x: DeviceArray, low: float, high: float, x_out: DeviceArray) -> None:
    run(_kernels().clamp, x, low, high, x_out)


def _coefficient(value: float | DeviceArray) -> tuple[float, DeviceArray]:
    """Split a value into a number and a scalar, whose product the value is."""
    return (1.0, value) if isinstance(value, DeviceArray) else (value, one())
