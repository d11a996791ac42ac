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
def _axpby_scalar_kernel(
    alpha: wp.float64,
    x: wp.array(dtype=wp.float64),
    beta: wp.float64,
    y: wp.array(dtype=wp.float64),
    y_out: wp.array(dtype=wp.float64),
):
    y_out[0] = alpha * x[0] + beta * y[0]


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
def _parts(device: str) -> Any:
    return wp.empty(_BLOCKS, dtype=wp.float64, device=device)


def dot(a: Any, b: Any, product_out: Any) -> None:
    device = a.device
    if device.is_cpu:
        launch(kernel("vector.h", "dot"), 1, [flat(a), flat(b)], [product_out], device=device)
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
        launch(_axpby_scalar_kernel, 1, [alpha, x, beta, y], [y_out], device=y_out.device)
        return
    _for_each("a * xs[i] + b * ys[i]", y_out, x, y, a=alpha, b=beta)


def multiply(x: Any, y: Any, product_out: Any) -> None:
    _for_each("xs[i] * ys[i]", product_out, x, y)


def divide(x: Any, y: Any, quotient_out: Any) -> None:
    _for_each("ys[i] != 0.f ? xs[i] / ys[i] : 0.f", quotient_out, x, y)


def fill(value: Any, x_out: Any) -> None:
    _for_each("a", x_out, x_out, a=value)


def select(condition: Any, x: Any, y: Any, chosen_out: Any) -> None:
    _for_each("xs[i] > 0.f ? ys[i] : zs[i]", chosen_out, condition, x, y)


def threshold(x: Any, threshold: float, x_out: Any) -> None:
    _for_each("xs[i] >= a ? xs[i] : 0.f", x_out, x, a=threshold)


def clamp(x: Any, low: Any, high: Any, x_out: Any) -> None:
    _for_each("wp::clamp(xs[i], a, b)", x_out, x, a=low, b=high)


def given(value: Any) -> tuple[float, Any]:
    """Return the two arguments that a `Number` is: what is given, and the scalar on the device that holds it."""
    return (0.0, value) if isinstance(value, wp.array) else (float(value), None)


def _for_each(each: str, result_out: Any, x: Any, y: Any = None, z: Any = None, *, a: Any = 0, b: Any = 0) -> None:
    """Write `each`, made of numbers a and b and of fields xs[i], ys[i] and zs[i].

    A CPU does it in one go, a GPU has a thread for each number.
    """
    fields = [flat(x), None if y is None else flat(y), None if z is None else flat(z)]
    many = result_out.size if result_out.device.is_cpu else 1
    inputs = [*given(a), *given(b), many, *fields]
    work = kernel("vector.h", "for_each", EACH=each)
    launch(work, result_out.size // many, inputs, [flat(result_out)], device=result_out.device)
