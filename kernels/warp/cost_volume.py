"""Cost volumes: averages of like pixels, and the least; `kernels/reference/cost_volume.py` says which."""

from typing import Any

from lfgpu.contract import REDUCTION

from .native_code import kernel
from .threads import launch, launch_rows, launch_slices, room_for
from .vector import given

_BLOCK = 32  # columns that a CPU works on at a time
_SLICES = 8  # of the volume, for which a thread of a GPU reads weights once
_TILE = (8, 32)  # rows and columns of pixels of a block on a GPU


def _pixels_kernel(radius: int) -> Any:
    numbers = {"RADIUS": radius, "SIDE": 2 * radius + 1, "SLICES": _SLICES, "ROWS": _TILE[0], "COLUMNS": _TILE[1]}
    return kernel("cost_volume.cuh", "average_pixel", **numbers)


def _add_kernel() -> Any:
    return kernel("cost_volume.h", "add_reduced", REDUCTION=REDUCTION)


def _minimum_kernel(name: str, block: int) -> Any:
    """Return the kernel for `block` columns at a time."""
    return kernel("cost_volume.h", name, BLOCK=block)


def nlm_average(weights: Any, volume: Any, *, window: int, average_out: Any) -> None:
    (count, height, width), device = volume.shape, volume.device
    if device.is_cuda:
        tiles = -(-height // _TILE[0]) * -(-width // _TILE[1])
        block = _TILE[0] * _TILE[1]
        dim = tiles * -(-count // _SLICES) * block
        average = _pixels_kernel(window // 2)
        launch(average, dim, [weights, volume], [average_out], device=device, block_dim=block)
        return
    room = room_for(device, window * window * _BLOCK)
    average = kernel("cost_volume.h", "average_rows", RADIUS=window // 2, SIDE=window, BLOCK=_BLOCK)
    launch_slices(average, height, [weights, volume], average_out, room=room)


def add_reduced(reduced: Any, shares: Any, *, weight: float, volume_inout: Any) -> None:
    launch_rows(_add_kernel(), [reduced, shares, weight], volume_inout)


def least_costs(volume: Any, *, least_out: Any) -> None:
    launch_rows(_minimum_kernel("find_least", _BLOCK if volume.device.is_cpu else 1), [volume], least_out)


def winner_takes_all(volume: Any, *, first: Any, step: float, disparity_out: Any, labels: Any = None) -> None:
    find = _minimum_kernel("find_lowest", _BLOCK if volume.device.is_cpu else 1)
    count = given(len(volume) if labels is None else labels)
    launch_rows(find, [volume, *count, *given(first), step], disparity_out)
