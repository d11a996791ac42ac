"""What a solver does with fields, on the device."""

import numpy as np
import taichi as ti

from .memory import DeviceArray, flat
from .runtime import on_cpu, run

_PARTS = 16384  # partial sums of a dot product, one for each thread of a GPU


@ti.kernel
def _copy_kernel(source: flat(), target_out: flat()):
    for i in range(source.shape[0]):
        target_out[i] = source[i]


@ti.kernel
def _axpby_kernel(alpha: float, x: flat(), beta: float, y: flat(), y_out: flat()):
    for i in range(x.shape[0]):
        y_out[i] = alpha * x[i] + beta * y[i]


@ti.kernel
def _multiply_kernel(x: flat(), y: flat(), product_out: flat()):
    for i in range(x.shape[0]):
        product_out[i] = x[i] * y[i]


@ti.kernel
def _clamp_kernel(x: flat(), low: float, high: float, x_out: flat()):
    for i in range(x.shape[0]):
        x_out[i] = ti.math.clamp(x[i], low, high)


@ti.kernel
def _dot_kernel(x: flat(), y: flat(), serial: ti.template(), sums_out: ti.types.ndarray(dtype=ti.f64, ndim=1)):
    """Partial sums over parts of the fields: each in one piece on a CPU, interleaved on a GPU."""
    for part in range(_PARTS):
        total = ti.cast(0.0, ti.f64)
        step, i, last = _PARTS, part, x.shape[0]
        if ti.static(serial):
            length = (x.shape[0] + _PARTS - 1) // _PARTS
            step, i, last = 1, part * length, ti.min((part + 1) * length, x.shape[0])
        while i < last:
            total += ti.cast(x[i], ti.f64) * ti.cast(y[i], ti.f64)
            i += step
        sums_out[part] = total


def dot(a: DeviceArray, b: DeviceArray) -> float:
    sums = np.empty(_PARTS)
    run(_dot_kernel, a.values, b.values, on_cpu(), sums)
    return float(sums.sum())


def copy(source: DeviceArray, target_out: DeviceArray) -> None:
    run(_copy_kernel, source.values, target_out.values)


def axpby(alpha: float, x: DeviceArray, beta: float, y: DeviceArray, y_out: DeviceArray) -> None:
    run(_axpby_kernel, alpha, x.values, beta, y.values, y_out.values)


def multiply(x: DeviceArray, y: DeviceArray, product_out: DeviceArray) -> None:
    run(_multiply_kernel, x.values, y.values, product_out.values)


def clamp(x: DeviceArray, low: float, high: float, x_out: DeviceArray) -> None:
    run(_clamp_kernel, x.values, low, high, x_out.values)
