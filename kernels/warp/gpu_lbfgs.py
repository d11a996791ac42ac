"""The direction of L-BFGS on a GPU: inner products, the recursion, and the combination; `lbfgs.py` says of what."""

from typing import Any

import warp as wp

from .native_code import kernel
from .threads import check_size, launch

wp.set_module_options({"enable_backward": False})

LEAST_CURVATURE = 1e-10  # least s . y over |s| |y| of a pair that is kept


@wp.struct
class State:
    """One number each."""

    go_on: wp.array(dtype=wp.float64)
    step: wp.array(dtype=wp.float64)
    slope: wp.array(dtype=wp.float64)
    accepted: wp.array(dtype=int)
    rejections: wp.array(dtype=int)
    judged: wp.array(dtype=int)
    newest: wp.array(dtype=int)  # slot of the newest pair
    pairs: wp.array(dtype=int)
    length: wp.array(dtype=int)  # of the trace
    flat: wp.array(dtype=int)


PARTS = 128  # of each inner product
MOST_ROWS = 32  # of which the recursion knows how to make a direction: a lane each
_ROWS = 9  # of which a block has the inner products
_BLOCK = 256
_TURNS = 4  # groups of threads that fetch the sums


def _products_kernel() -> Any:
    numbers = {"PARTS": PARTS, "ROWS": _ROWS, "BLOCK": _BLOCK}
    return kernel("lbfgs.cuh", "find_products", State=State, **numbers)


def _recursion_kernel() -> Any:
    numbers = {"TURNS": _TURNS, "LEAST_CURVATURE": str(LEAST_CURVATURE)}  # float64
    return kernel("lbfgs.cuh", "find_coefficients", State=State, **numbers)


def _combine_kernel(rows: int) -> Any:
    return kernel("lbfgs.cuh", "combine", COUNT=rows, BLOCK=_BLOCK)


def products(state: State, stack: Any, sums_out: Any) -> None:
    dim = -(-len(stack) // _ROWS) * PARTS * _BLOCK
    launch(_products_kernel(), dim, [state, stack], [sums_out], device=stack.device, block_dim=_BLOCK)


def recursion(inputs: list[Any], products: Any, coefficients_out: Any) -> None:
    outputs, threads = [products, coefficients_out], 128 * _TURNS
    launch(_recursion_kernel(), threads, inputs, outputs, device=products.device, block_dim=threads)


def combine(inputs: list[Any], direction_out: Any) -> None:
    dim = -(-direction_out.size // _BLOCK) * _BLOCK
    check_size(dim)
    launch(_combine_kernel(len(inputs[0])), dim, inputs, [direction_out], device=direction_out.device, block_dim=_BLOCK)
