"""Semi-global matching; `kernels/reference/semi_global.py` says which.

A CPU follows one direction after the other, blocks of paths at a time. A GPU follows paths of several directions at the
same time, each direction with a volume of its own.
"""

from typing import Any

import numpy as np
import warp as wp

from .memory import pixel_type
from .native_code import kernel
from .threads import check_size, is_preparing, launch, launch_slices, room_for
from .vector import given

_DIRECTIONS = ((1, -1), (1, 0), (1, 1), (0, 1), (-1, -1), (-1, 0), (-1, 1), (0, -1))  # (dy, dx)
_BLOCK = 64  # paths that a CPU follows together, a multiple of the chunk
_CHUNK = 16  # columns of a row that it turns at a time, so that paths along rows lie side by side; a power of 2
_WARP = 32
_AHEAD = 4  # steps along a path, whose costs are on their way to a GPU's threads
_WARPS = 4  # of a block of a GPU, each with a path
_TILE = 32  # pixels of a row and disparities of them, that a GPU turns at a time
_TURNING = 256  # threads that do so
_ROOM = 2**29  # bytes: volumes that a GPU needs besides, at most, unless two are larger

_STEPS = dict(zip(("DOWNWARDS", "SIDEWAYS"), zip(*_DIRECTIONS, strict=True), strict=True))


def _blocks_kernel(channels: int) -> Any:
    # Of two rows one after the other, the places whose numbers alternate in a merged row.
    left, right = np.arange(2 * _CHUNK).reshape(2, 2, -1).transpose(1, 2, 0).reshape(2, -1).tolist()
    numbers = {"CHANNELS": channels, "BLOCK": _BLOCK, "CHUNK": _CHUNK, "LEFT": tuple(left), "RIGHT": tuple(right)}
    return kernel("semi_global.h", "follow_blocks", Pixel=pixel_type(channels), **numbers)


def _step_costs_kernel(channels: int) -> Any:
    return kernel("semi_global.cuh", "find_step_costs", Pixel=pixel_type(channels), CHANNELS=channels, **_STEPS)


def _path_kernel(each: int) -> Any:
    """Return the kernel for `each` disparities on each thread."""
    return kernel("semi_global.cuh", "follow_path", EACH=each, AHEAD=max(1, _AHEAD // each), **_STEPS)


def _turn_kernel() -> Any:
    return kernel("semi_global.cuh", "turn", TILE=_TILE, TURNING=_TURNING)


def semi_global(
    volume: Any, image: Any, penalty_scale: Any, *, small: Any, large: Any, contrast: float, sum_out: Any
) -> None:
    if not volume.device.is_cpu:
        _on_gpu(volume, [image, penalty_scale, *given(small), *given(large), contrast], sum_out)
        return
    for k, (dy, dx) in enumerate(_DIRECTIONS):
        inputs = [volume, image, penalty_scale, *given(small), *given(large), contrast, dy, dx, k > 0]
        _on_cpu(inputs, image.dtype._length_, dy, dx, sum_out)


def _on_cpu(inputs: list[Any], channels: int, dy: int, dx: int, sum_out: Any) -> None:
    (count, height, width), device = sum_out.shape, sum_out.device
    paths = width + abs(dx) * (height - 1) if dy else height
    blocks = -(-paths // _BLOCK)
    room = room_for(device, (count + 1 + count * _CHUNK) * _BLOCK)
    launch_slices(_blocks_kernel(channels), blocks, inputs, sum_out, room=room)


def _on_gpu(volume: Any, inputs: list[Any], sum_out: Any) -> None:
    (count, height, width), device, image = sum_out.shape, sum_out.device, inputs[0]
    size, pixels = sum_out.size, height * width
    room = _room_of(sum_out)
    steps_to, costs, turned = room[: 16 * pixels], room[16 * pixels :][:size], room[16 * pixels + size :]
    as_turned = wp.array(ptr=costs.ptr, dtype=float, shape=(height, width, count), device=device, copy=False)
    launch(_step_costs_kernel(image.dtype._length_), pixels, [*inputs, width], [steps_to], device=device)
    turning = height * -(-width // _TILE) * -(-count // _TILE) * _TURNING
    check_size(turning)
    options = {"device": device, "block_dim": _TURNING}
    launch(_turn_kernel(), turning, [volume, costs, 0, False], **options)
    each, at_once = -(-count // _WARP), len(turned) // size
    # The next light field has another range: the kernels beside are compiled with the one of the first.
    kernels = [_path_kernel(k) for k in range(max(1, each - 1), each + 2)] if is_preparing() else [_path_kernel(each)]
    for first in range(0, len(_DIRECTIONS), at_once):
        some = _DIRECTIONS[first : first + at_once]
        paths = sum(width if dy else height for dy, _ in some)
        threads = -(-paths // _WARPS) * _WARPS * _WARP
        inputs = [as_turned, steps_to, first, first + len(some)]
        for follow in kernels:
            launch(follow, threads, inputs, [turned], device=device, block_dim=_WARPS * _WARP)
        launch(_turn_kernel(), turning, [sum_out, turned, len(some), first > 0], **options)


def _room_of(sum_out: Any) -> Any:
    """Return memory for costs of changes and turned volumes of as many directions as fit; it lives with the sums."""
    if not hasattr(sum_out, "lfgpu_room"):
        count, size = len(_DIRECTIONS), sum_out.size
        volumes = 1 + min(count, max(1, _ROOM // (4 * size) - 1))
        room = 2 * count * (size // sum_out.shape[0]) + volumes * size
        sum_out.lfgpu_room = wp.empty(room, dtype=float, device=sum_out.device)
    return sum_out.lfgpu_room
