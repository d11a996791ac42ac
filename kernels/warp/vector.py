"""What a solver does with fields, on the device."""

from typing import Any

import numpy as np
import warp as wp
from warp.utils import array_inner

wp.set_module_options({"enable_backward": False})


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


def dot(a: Any, b: Any) -> float:
    if a.device.is_cpu:
        return float(np.einsum("i,i->", a.numpy().ravel(), b.numpy().ravel(), dtype=np.float64))
    return float(array_inner(a.flatten(), b.flatten()))


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
