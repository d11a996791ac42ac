"""Views compared at a low resolution, to find which disparities there are; `RangeSearch` in `lfgpu/contract` says how.

A CPU works on some columns of a row at once, a thread of a GPU on one column.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import UNSEEN, Details, Disparities, sweep_shifts

from .memory import pixel_type, start
from .native_code import kernel
from .threads import Rooms, check_size, in_slices, launch, launch_rows, load
from .views import indices

_BLOCK = 128  # columns that a CPU works on at a time
_AT_ONCE = 64  # disparities that a GPU compares at a time; a CPU compares one, so that its sums stay in the cache


def _block(device: Any) -> int:
    return _BLOCK if device.is_cpu else 1


def _shrink_kernel(channels: int, stored: Any, block: int) -> Any:
    stored_pixel = pixel_type(channels, stored)
    return kernel("range_search.h", "shrink", Stored=stored_pixel, BLOCK=block, CHANNELS=channels)


def _kernel(name: str, block: int) -> Any:
    """Any other kernel: it knows fields only."""
    return kernel("range_search.h", name, BLOCK=block, UNSEEN=UNSEEN)


def shrink(views: Any, chosen: Sequence[int], valid: Any, *, scale: float, factor: int, images_out: Any) -> None:
    work = _shrink_kernel(views.dtype._length_, views.dtype._wp_scalar_type_, _block(views.device))
    line = indices(tuple(int(index) for index in chosen), views.device.alias)
    count, height, _ = images_out.shape
    launch_rows(work, [views, line, valid, scale, factor], images_out, rows=count * height)


def details(shape: Sequence[int], device: str, *, factor: int, window: int) -> Details:
    start()
    n, height, width = shape[0], shape[1] // factor, shape[2] // factor
    smaller = wp.empty((n, height, width), dtype=float, device=device)
    sums = wp.empty((n, height, width), dtype=wp.vec2f, device=device)
    block = _block(smaller.device)
    again, add, subtract = (_kernel(name, block) for name in ("shrink_again", "add_rows", "subtract_means"))

    def evaluate(images: Any, details_out: Any) -> None:
        if factor > 1:
            launch_rows(again, [images, factor], smaller, rows=n * height)
            images = smaller
        launch_rows(add, [images, window], sums, rows=n * height)
        launch_rows(subtract, [images, sums, window], details_out, rows=n * height)

    return evaluate


class side_costs:
    """Memory for the shifts of the views, side by side, and for the sums of some disparities."""

    def __init__(
        self,
        shape: Sequence[int],
        offsets: NDArray[Any],
        lines: Sequence[Sequence[Sequence[int]]],
        device: str,
        *,
        reference: int,
        count: int,
    ) -> None:
        start()
        sides = [side for line in lines for side in line]
        views = [int(view) for side in sides for view in side]
        self._reference, (_, self._height, self._width) = reference, shape
        self._sides, self._count, self._offsets = len(sides), count, offsets[views]
        self._views = indices(tuple(views), device)
        self._ends, self._lines = (
            indices(tuple(accumulate(map(len, some), initial=0)), device) for some in (sides, lines)
        )
        self._shifts = wp.empty((count, len(views)), dtype=wp.vec4f, device=device)
        place = self._shifts.device
        self._differences, self._costs = (_kernel(name, _block(place)) for name in ("add_differences", "find_costs"))
        self._at_once = 1 if place.is_cpu else min(_AT_ONCE, self._count)
        size = 1, self._at_once * self._sides, self._height * self._width
        self._rooms = Rooms(place, lambda: wp.empty(size, dtype=wp.vec2f, device=place))
        self._given: tuple[float, float] | None = None

    def __call__(self, details: Any, first: float, step: float, volume_out: Any) -> None:
        place = self._shifts.device
        if self._given != (first, step):
            shifts = sweep_shifts(self._offsets, Disparities(first, step, self._count))
            whole = np.floor(shifts)
            self._shifts.assign(np.concatenate([whole, shifts - whole], axis=2).astype(np.float32))
            self._given = first, step
        lanes = 1 if place.is_cpu else self._width
        check_size(self._at_once * self._sides * self._height * lanes)
        load(place, self._differences, self._costs)

        def some(k: int, begin: int, end: int) -> None:
            for label in range(begin, end, self._at_once):
                rows = min(self._at_once, end - label) * self._height
                room = self._rooms[k]
                compared = [details, self._reference, self._shifts, self._views, self._ends, label, 0, lanes]
                launch(self._differences, rows * self._sides * lanes, compared, [room], device=place)
                added = [room, self._ends, self._lines, label, 0, lanes]
                launch(self._costs, rows * lanes, added, [volume_out], device=place)

        in_slices(place, self._count, some)


def distinct_minimum(volume: Any, *, apart: int, found_out: Sequence[Any]) -> None:
    launch_rows(_kernel("find_distinct", _block(volume.device)), [volume, apart], *found_out)


def agreeing_disparity(
    found: Sequence[Any],
    noise: Any,
    *,
    least_noise: float,
    same: float,
    other: float,
    neighbors: int,
    first: float,
    step: float,
    disparity_out: Any,
) -> None:
    place, _, _, others, worst = found
    numbers = [noise, least_noise, same, other, neighbors, first, step]
    launch_rows(_kernel("find_agreeing", 1), [place, others, worst, *numbers], disparity_out)
