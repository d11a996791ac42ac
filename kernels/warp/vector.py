"""What a solver does with fields, on the device."""

from typing import Any

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})

_DOT_THREADS = 16384


@wp.kernel
def _axpby_kernel(
    alpha: float, x: wp.array(dtype=float), beta: float, y: wp.array(dtype=float), y_out: wp.array(dtype=float)
):
    i = wp.tid()
    y_out[i] = alpha * x[i] + beta * y[i]


@wp.kernel
def _multiply_kernel(x: wp.array(dtype=float), y: wp.array(dtype=float), product_out: wp.array(dtype=float)):
    i = wp.tid()
    product_out[i] = x[i] * y[i]


@wp.kernel
def _clamp_kernel(x: wp.array(dtype=float), low: float, high: float, x_out: wp.array(dtype=float)):
    i = wp.tid()
    x_out[i] = wp.clamp(x[i], low, high)


@wp.kernel
def _dot_kernel(x: wp.array(dtype=float), y: wp.array(dtype=float), threads: int, sum_out: wp.array(dtype=wp.float64)):
    total = wp.float64(0.0)
    first = wp.tid()
    for i in range(first, x.shape[0], threads):
        total = total + wp.float64(x[i]) * wp.float64(y[i])
    wp.atomic_add(sum_out, 0, total)


def dot(a: Any, b: Any) -> float:
    if a.device.is_cpu:
        return float(np.einsum("i,i->", a.numpy().ravel(), b.numpy().ravel(), dtype=np.float64))
    total = wp.zeros(1, dtype=wp.float64, device=a.device)
    wp.launch(_dot_kernel, _DOT_THREADS, [a.flatten(), b.flatten(), _DOT_THREADS], [total], device=a.device)
    return float(total.numpy()[0])


def copy(source: Any, target_out: Any) -> None:
    wp.copy(target_out, source)


def axpby(alpha: float, x: Any, beta: float, y: Any, y_out: Any) -> None:
    _launch(_axpby_kernel, [alpha, x.flatten(), beta, y.flatten()], y_out)


def multiply(x: Any, y: Any, product_out: Any) -> None:
    _launch(_multiply_kernel, [x.flatten(), y.flatten()], product_out)


def clamp(x: Any, low: float, high: float, x_out: Any) -> None:
    _launch(_clamp_kernel, [x.flatten(), low, high], x_out)


def _launch(kernel: Any, inputs: list[Any], result_out: Any) -> None:
    wp.launch(kernel, result_out.size, inputs, [result_out.flatten()], device=result_out.device)
