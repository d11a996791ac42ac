"""The nearest disparities in each view, as `kernels/reference/alignment.py` defines them.

The z-buffers have a border, so that what lands beyond the frame comes near, too. The plan has one for each slice of the
views on a CPU, and as many as fit into the cache on a GPU.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from lfgpu.contract import ZBuffer

from .native_code import kernel
from .splat import as_offsets
from .threads import check_size, in_slices, launch, load, once, slices

_NOWHERE = -1e6  # the disparity of what nothing comes near
_BUFFER = 20 * 2**20  # bytes


@once
def _cpu_kernels() -> list[Any]:
    names = "clear", "land", "look_around"
    return [kernel("z_buffer.h", name, module="lfgpu_z_buffer", NOWHERE=_NOWHERE) for name in names]


@once
def _gpu_kernels(border: int) -> list[Any]:
    numbers = {"module": f"lfgpu_gpu_z_buffer_{border}", "BORDER": border, "NOWHERE": _NOWHERE}
    return [kernel("z_buffer.cuh", name, **numbers) for name in ("land", "look_around")]


def z_buffer(shape: Sequence[int], offsets: Any, *, reach: int) -> ZBuffer:
    assert 0 <= reach <= 100, f"reach is {reach}: a row of look_around has room for less than 128 on a CPU"
    (count, height, width, _), device, pairs, border = shape, offsets.device, as_offsets(offsets), reach + 1
    size = (height + 2 * border) * (width + 2 * border)
    if not device.is_cpu:
        return _gpu_z_buffer((count, height, width), pairs, border)
    room = [wp.empty(size, dtype=float, device=device) for _ in slices(device, count)]

    clear, land, look_around = _cpu_kernels()

    def find(disparity: Any, nearest_out: Any) -> None:
        load(device, clear)

        def some_views(k: int, first: int, last: int) -> None:
            for n in range(first, last):
                launch(clear, 1, [], [room[k]], device=device)
                launch(land, height, [disparity, pairs, n, border], [room[k]], device=device)
                launch(look_around, height, [room[k], reach], [nearest_out[n : n + 1]], device=device)

        in_slices(device, count, some_views)

    return find


def _gpu_z_buffer(shape: tuple[int, int, int], pairs: Any, border: int) -> ZBuffer:
    (count, height, width), device, (land, look_around) = shape, pairs.device, _gpu_kernels(border)
    size = (height + 2 * border) * (width + 2 * border)
    batch = min(count, max(1, _BUFFER // (4 * size)))
    keys = wp.empty(batch * size, dtype=wp.uint32, device=device)
    check_size(height * width)

    def find(disparity: Any, nearest_out: Any) -> None:
        for first in range(0, count, batch):
            last = min(count, first + batch)
            keys.zero_()
            inputs = [disparity, pairs[first:last], last - first, width]
            launch(land, height * width, inputs, [keys], device=device)
            launch(look_around, height * width, [keys, width], [nearest_out[first:last]], device=device)

    return find
