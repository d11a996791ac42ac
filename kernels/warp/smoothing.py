"""Views for comparisons: means of pixels that look alike, and reduced views. `kernels/reference/smoothing.py` says why.

On a CPU a thread has some rows, on a GPU a block of threads has a tile of a view.
"""

import math
from collections.abc import Sequence
from typing import Any

import warp as wp

from lfgpu.contract import REDUCTION, SMOOTHING_REACH, WHITE

from .memory import pixel_type
from .native_code import kernel
from .threads import check_size, launch, launch_rows, launch_slices, once, slices
from .vector import given
from .views import indices

_SPREAD = 8.0  # pixels²: twice the variance of the Gaussian over places
_TILE = (16, 32)  # rows and columns of a block on a GPU
_PIXELS = 2  # of a column, that a thread has
_THREADS = _TILE[0] // _PIXELS * _TILE[1]  # of such a block
_RING = 16  # rows that a thread of a CPU keeps
_LANES = 16  # columns that it works on at a time

_NUMBERS = {
    "WHITE": WHITE,
    "REACH": SMOOTHING_REACH,
    "NEAR": ", ".join(f"{math.exp(-(k**2) / _SPREAD):.9e}f" for k in range(-SMOOTHING_REACH, SMOOTHING_REACH + 1)),
}


def _types(channels: int, stored: Any) -> dict[str, Any]:
    return {"Stored": pixel_type(channels, stored), "Smoothed": pixel_type(channels, wp.uint16), "CHANNELS": channels}


@once
def _tiles_kernel(channels: int, stored: Any) -> Any:
    numbers = {**_NUMBERS, "ROWS": _TILE[0], "COLUMNS": _TILE[1], "PIXELS": _PIXELS, "THREADS": _THREADS}
    tiles = kernel("smoothing.cuh", "smooth_tile", **_types(channels, stored), **numbers)
    tiles.module.options["fast_math"] = True  # divisions that need not look at numbers near those that underflow
    return tiles


def _reduce_kernel(channels: int, stored: Any) -> Any:
    types = {"Stored": pixel_type(channels, stored), "Reduced": pixel_type(channels, wp.uint16)}
    numbers = {"CHANNELS": channels, "REDUCTION": REDUCTION, "WHITE": WHITE}
    return kernel("smoothing.h", "reduce_rows", **types, **numbers)


def smooth_views(
    views: Any,
    valid: Any,
    *,
    scale: float,
    deviation: Any,
    views_out: Any,
    chosen: Sequence[int] | None = None,
) -> None:
    (n, height, width), device = views_out.shape, views.device
    order = None if chosen is None else indices(tuple(chosen), device.alias)
    channels, stored = views.dtype._length_, views.dtype._wp_scalar_type_
    if device.is_cuda:
        dim = n * -(-height // _TILE[0]) * -(-width // _TILE[1]) * _THREADS
        check_size(dim)
        inputs = [views, valid, order, scale, *given(deviation)]
        launch(_tiles_kernel(channels, stored), dim, inputs, [views_out], device=device, block_dim=_THREADS)
        return
    wide = width + 2 * (SMOOTHING_REACH + 1) + _LANES
    parts = len(slices(device, n * height))
    room = wp.zeros((parts, (_RING * (2 * channels + 2) + 1) * wide), dtype=float, device=device)
    smooth = kernel("smoothing.h", "smooth_rows", **_types(channels, stored), **_NUMBERS, RING=_RING, LANES=_LANES)
    launch_slices(smooth, n * height, [views, valid, order, scale, *given(deviation)], views_out, room=room)


def reduce_views(views: Any, valid: Any, *, scale: float, views_out: Any, valid_out: Any) -> None:
    reduce, rows = _reduce_kernel(views.dtype._length_, views.dtype._wp_scalar_type_), math.prod(views_out.shape[:2])
    launch_rows(reduce, [views, valid, scale], views_out, valid_out, rows=rows)
