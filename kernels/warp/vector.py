"""Vector operations of solvers, on the device."""

from typing import Any

import warp as wp

from .native_code import kernel
from .threads import flat, launch, launch_tiles, once

wp.set_module_options({"enable_backward": False})

BLOCK = 256
_BLOCKS = 128  # of a dot product on a GPU


@wp.func
def value_of(number: float, scalar: wp.array(dtype=wp.float64)) -> float:
    """Return the scalar if there is one, else the number."""
    value = number
    if scalar:
        value = float(scalar[0])
    return value


@wp.kernel
def _axpby_kernel(
    alpha: float,
    alpha_scalar: wp.array(dtype=wp.float64),
    x: wp.array(dtype=float),
    beta: float,
    beta_scalar: wp.array(dtype=wp.float64),
    y: wp.array(dtype=float),
    y_out: wp.array(dtype=float),
):
    i = wp.tid()
    y_out[i] = value_of(alpha, alpha_scalar) * x[i] + value_of(beta, beta_scalar) * y[i]


@wp.kernel
def _axpby_scalar_kernel(
    alpha: wp.float64,
    x: wp.array(dtype=wp.float64),
    beta: wp.float64,
    y: wp.array(dtype=wp.float64),
    y_out: wp.array(dtype=wp.float64),
):
    y_out[0] = alpha * x[0] + beta * y[0]


@wp.kernel
def _multiply_kernel(x: wp.array(dtype=float), y: wp.array(dtype=float), product_out: wp.array(dtype=float)):
    i = wp.tid()
    product_out[i] = x[i] * y[i]


@wp.kernel
def _divide_kernel(x: wp.array(dtype=float), y: wp.array(dtype=float), quotient_out: wp.array(dtype=float)):
    i = wp.tid()
    quotient = float(0.0)
    if y[i] != 0.0:
        quotient = x[i] / y[i]
    quotient_out[i] = quotient


@wp.kernel
def _fill_kernel(value: float, scalar: wp.array(dtype=wp.float64), x_out: wp.array(dtype=float)):
    x_out[wp.tid()] = value_of(value, scalar)


@wp.kernel
def _choose_kernel(
    condition: wp.array(dtype=float),
    x: wp.array(dtype=float),
    y: wp.array(dtype=float),
    chosen_out: wp.array(dtype=float),
):
    i = wp.tid()
    chosen_out[i] = wp.where(condition[i] > 0.0, x[i], y[i])


@wp.kernel
def _at_least_kernel(x: wp.array(dtype=float), threshold: float, x_out: wp.array(dtype=float)):
    i = wp.tid()
    x_out[i] = wp.where(x[i] >= threshold, x[i], 0.0)


@wp.kernel
def _clamp_kernel(
    low: float,
    low_scalar: wp.array(dtype=wp.float64),
    x: wp.array(dtype=float),
    high: float,
    high_scalar: wp.array(dtype=wp.float64),
    x_out: wp.array(dtype=float),
):
    i = wp.tid()
    x_out[i] = wp.clamp(x[i], value_of(low, low_scalar), value_of(high, high_scalar))


@wp.kernel
def _ratio_kernel(
    numerator: wp.array(dtype=wp.float64),
    denominator: wp.array(dtype=wp.float64),
    factor: wp.float64,
    ratio_out: wp.array(dtype=wp.float64),
):
    ratio = wp.float64(0.0)
    if denominator[0] != wp.float64(0.0):
        ratio = factor * numerator[0] / denominator[0]
    ratio_out[0] = ratio


@wp.kernel
def partial_dot_kernel(
    x: wp.array(dtype=float), y: wp.array(dtype=float), threads: int, partial_out: wp.array(dtype=wp.float64)
):
    block, thread = wp.tid()
    total = wp.float64(0.0)
    for i in range(block * wp.block_dim() + thread, x.shape[0], threads):
        total = total + wp.float64(x[i]) * wp.float64(y[i])
    wp.tile_store(partial_out, wp.tile_sum(wp.tile(total)), offset=block)


@wp.kernel
def sum_kernel(parts: wp.array(dtype=wp.float64), total_out: wp.array(dtype=wp.float64)):
    """Compute the sum of all parts, by one block."""
    _, thread = wp.tid()
    total = wp.float64(0.0)
    for i in range(thread, parts.shape[0], wp.block_dim()):
        total = total + parts[i]
    wp.tile_store(total_out, wp.tile_sum(wp.tile(total)))


@once
def _dot_on_cpu_kernel() -> Any:
    return kernel("vector.h", "dot", module="lfgpu_vector_cpu")


@once
def _cpu_kernel(name: str, each: str) -> Any:
    """result[i] = `each`, made of numbers a and b and of fields xs[i] and ys[i]."""
    return kernel("vector.h", "for_each", module=f"lfgpu_vector_cpu_{name}", EACH=each)


@once
def _parts(device: str) -> Any:
    return wp.empty(_BLOCKS, dtype=wp.float64, device=device)


def dot(a: Any, b: Any, product_out: Any) -> None:
    device = a.device
    if device.is_cpu:
        launch(_dot_on_cpu_kernel(), 1, [flat(a), flat(b)], [product_out], device=device)
        return
    parts = _parts(device.alias)
    inputs = [flat(a), flat(b), _BLOCKS * BLOCK]
    launch_tiles(partial_dot_kernel, dim=[_BLOCKS], inputs=inputs, outputs=[parts], block_dim=BLOCK, device=device)
    launch_tiles(sum_kernel, dim=[1], inputs=[parts], outputs=[product_out], block_dim=BLOCK, device=device)


def ratio(numerator: Any, denominator: Any, ratio_out: Any, *, factor: float = 1.0) -> None:
    launch(_ratio_kernel, 1, [numerator, denominator, factor], [ratio_out], device=ratio_out.device)


def copy(source: Any, target_out: Any) -> None:
    wp.copy(target_out, source)


def axpby(alpha: Any, x: Any, beta: Any, y: Any, y_out: Any) -> None:
    if y_out.dtype is wp.float64:
        _launch(_axpby_scalar_kernel, [alpha, x, beta, y], y_out)
        return
    inputs = [*given(alpha), flat(x), *given(beta), flat(y)]
    if y_out.device.is_cpu:
        _launch_for_each("axpby", "a * xs[i] + b * ys[i]", inputs, y_out)
    else:
        _launch(_axpby_kernel, inputs, y_out)


def multiply(x: Any, y: Any, product_out: Any) -> None:
    if product_out.device.is_cpu:
        _launch_for_each("multiply", "xs[i] * ys[i]", [0.0, None, flat(x), 0.0, None, flat(y)], product_out)
    else:
        _launch(_multiply_kernel, [flat(x), flat(y)], product_out)


def divide(x: Any, y: Any, quotient_out: Any) -> None:
    if quotient_out.device.is_cpu:
        each, inputs = "ys[i] != 0.f ? xs[i] / ys[i] : 0.f", [0.0, None, flat(x), 0.0, None, flat(y)]
        _launch_for_each("divide", each, inputs, quotient_out)
    else:
        _launch(_divide_kernel, [flat(x), flat(y)], quotient_out)


def fill(value: Any, x_out: Any) -> None:
    _launch(_fill_kernel, [*given(value)], x_out)


def select(condition: Any, x: Any, y: Any, chosen_out: Any) -> None:
    _launch(_choose_kernel, [flat(condition), flat(x), flat(y)], chosen_out)


def threshold(x: Any, threshold: float, x_out: Any) -> None:
    _launch(_at_least_kernel, [flat(x), threshold], x_out)


def clamp(x: Any, low: Any, high: Any, x_out: Any) -> None:
    inputs = [*given(low), flat(x), *given(high)]
    if x_out.device.is_cpu:
        _launch_for_each("clamp", "wp::clamp(xs[i], a, b)", [*inputs, flat(x)], x_out)
    else:
        _launch(_clamp_kernel, inputs, x_out)


def given(value: Any) -> tuple[float, Any]:
    """Return the two arguments that a `Number` is: what is given, and the scalar on the device that holds it."""
    return (0.0, value) if isinstance(value, wp.array) else (float(value), None)


def _launch(kernel: Any, inputs: list[Any], result_out: Any) -> None:
    launch(kernel, result_out.size, inputs, [flat(result_out)], device=result_out.device)


def _launch_for_each(name: str, each: str, inputs: list[Any], result_out: Any) -> None:
    launch(_cpu_kernel(name, each), 1, inputs, [flat(result_out)], device=result_out.device)
