"""The nearest disparities in each view, as `kernels/reference/alignment.py` defines them.

The z-buffers have a border, so that what lands beyond the frame comes near, too. The plan has one for each thread of a
CPU, and as many as fit into the cache on a GPU.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import ZBuffer

from .native_code import kernel
from .splat import as_offsets
from .threads import check_size, in_slices, launch, load, room_for

_NOWHERE = -1e6  # the disparity of what nothing comes near
_BUFFER = 20 * 2**20  # bytes


def _gpu_kernels(border: int) -> list[Any]:
    return [kernel("z_buffer.cuh", name, BORDER=border, NOWHERE=_NOWHERE) for name in ("land", "look_around")]


def z_buffer(size: Sequence[int], device: str, *, reach: int) -> ZBuffer:
    assert 0 <= reach <= 100, f"reach is {reach}: a row of look_around has room for less than 128 on a CPU"
    (height, width), place = size, wp.get_device(device)
    room = (height + 2 * reach + 2) * (width + 2 * reach + 2)
    if not place.is_cpu:
        return _gpu_z_buffer((height, width), room, place)
    rooms = room_for(place, room)

    names, module = ("clear", "land", "look_around"), "lfgpu_z_buffer"
    clear, land, look_around = (kernel("z_buffer.h", name, module=module, NOWHERE=_NOWHERE) for name in names)

    def find(disparity: Any, offsets: Any, nearest_out: Any, *, reach: int) -> None:
        pairs, used = as_offsets(offsets), (height + 2 * reach + 2) * (width + 2 * reach + 2)
        there = np.flatnonzero(~np.isnan(offsets.numpy()[:, 0])).tolist()
        load(place, clear)

        def some_views(k: int, first: int, last: int) -> None:
            fronts = rooms[k][:used]
            for n in there[first:last]:
                launch(clear, 1, [], [fronts], device=place)
                launch(land, height, [disparity, pairs, n, reach + 1], [fronts], device=place)
                launch(look_around, height, [fronts, reach], [nearest_out[n : n + 1]], device=place)

        in_slices(place, len(there), some_views)

    return find


def _gpu_z_buffer(size: tuple[int, int], room: int, device: Any) -> ZBuffer:
    (height, width), batch = size, max(1, _BUFFER // (4 * room))
    keys = wp.empty(batch * room, dtype=wp.uint32, device=device)
    check_size(height * width)

    def find(disparity: Any, offsets: Any, nearest_out: Any, *, reach: int) -> None:
        pairs, (land, look_around), count = as_offsets(offsets), _gpu_kernels(reach + 1), len(offsets)
        for first in range(0, count, batch):
            last = min(count, first + batch)
            keys.zero_()
            inputs = [disparity, pairs[first:last], last - first, width]
            launch(land, height * width, inputs, [keys], device=device)
            launch(
                look_around, height * width, [keys, pairs[first:last], width], [nearest_out[first:last]], device=device
            )

    return find
