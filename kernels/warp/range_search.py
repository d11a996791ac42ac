"""Views compared at a low resolution, to find which disparities there are; `RangeSearch` in `lfgpu/contract` says how.

All of it is native code for some columns of a row at once: a CPU's vector units work on them together. A thread of a
GPU has one column.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import UNSEEN, Details, Disparities, SideCosts, sweep_shifts

from .cost_volume import code
from .memory import pixel_type, start
from .threads import check_size, in_slices, launch, load, once, slices
from .views import indices

wp.set_module_options({"enable_backward": False})

_BLOCK = 128  # columns that a CPU works on at a time
_AT_ONCE = 64  # disparities that a GPU compares at a time; a CPU compares one, so that its sums stay in the cache


def _block(device: Any) -> int:
    return _BLOCK if device.is_cpu else 1


def _launch_lines(kernel: Any, inputs: list[Any], out: Any, rows: int, width: int) -> None:
    """Launch kernel(*inputs, row, lanes, out) over some rows of `width` pixels: thread i has the row row + i / lanes,
    and there blocks of columns, every lanes-th from i % lanes on.
    """
    device = out.device
    lanes = 1 if device.is_cpu else width
    check_size(rows * lanes)
    load(device, kernel)

    def some_rows(_: int, first: int, last: int) -> None:
        launch(kernel, (last - first) * lanes, [*inputs, first, lanes], [out], device=device)

    in_slices(device, rows, some_rows)


# --- details ---

_SHRINK = """
    const int height = images.shape[1], width = images.shape[2], full = views.shape[2];
    const int k = line / height, y = line - k * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
    const size_t at = (size_t)y * factor * full + (size_t)x0 * factor, size = (size_t)views.shape[1] * full;
    float total[BLOCK] = {}, unknown[BLOCK] = {};
    for (int r = 0; r < factor; ++r) {
        const auto* const row = views.data + chosen.data[k] * size + at + (size_t)r * full;
        for (int j = 0; j < columns; ++j)
            for (int s = 0; s < factor; ++s)
                for (int c = 0; c < CHANNELS; ++c) total[j] += (float)row[j * factor + s].c[c];
        if (!valid.data) continue;
        const float* const mask = valid.data + k * size + at + (size_t)r * full;
        for (int j = 0; j < columns; ++j)
            for (int s = 0; s < factor; ++s) unknown[j] += mask[j * factor + s] != 0.f ? 0.f : 1.f;
    }
    float* const out = images.data + (size_t)line * width + x0;
    const float share = scale / (float)(factor * factor * CHANNELS);
    for (int j = 0; j < columns; ++j) out[j] = unknown[j] == 0.f ? share * total[j] : NAN;
"""

_SHRINK_AGAIN = """
    const int height = smaller.shape[1], width = smaller.shape[2], full = images.shape[2];
    const int n = line / height, y = line - n * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
    const float* const from = images.data + ((size_t)n * images.shape[1] + y * factor) * full + (size_t)x0 * factor;
    float total[BLOCK] = {};
    for (int r = 0; r < factor; ++r)
        for (int j = 0; j < columns; ++j)
            for (int s = 0; s < factor; ++s) total[j] += from[(size_t)r * full + j * factor + s];
    float* const out = smaller.data + (size_t)line * width + x0;
    for (int j = 0; j < columns; ++j) out[j] = total[j] / (float)(factor * factor);
"""

_ROW_SUMS = """
    const int width = images.shape[2], columns = width - x0 < BLOCK ? width - x0 : BLOCK, radius = window / 2;
    const float* const row = images.data + (size_t)line * width;
    float total[BLOCK] = {}, known[BLOCK] = {};
    for (int k = x0 - radius; k <= x0 + radius; ++k) {
        float values[BLOCK];
        const int begin = k >= 0 ? 0 : -k < columns ? -k : columns;
        const int end = width - k >= columns ? columns : width - k > begin ? width - k : begin;
        for (int j = 0; j < begin; ++j) values[j] = row[0];
        for (int j = begin; j < end; ++j) values[j] = row[k + j];
        for (int j = end; j < columns; ++j) values[j] = row[width - 1];
        for (int j = 0; j < columns; ++j) {
            const bool is_known = values[j] == values[j];
            total[j] += is_known ? values[j] : 0.f;
            known[j] += is_known ? 1.f : 0.f;
        }
    }
    wp::vec2f* const out = sums.data + (size_t)line * width + x0;
    for (int j = 0; j < columns; ++j) {
        out[j].c[0] = total[j];
        out[j].c[1] = known[j];
    }
"""

_SUBTRACT = """
    const int height = images.shape[1], width = images.shape[2], radius = window / 2;
    const int n = line / height, y = line - n * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
    float total[BLOCK] = {}, known[BLOCK] = {};
    for (int k = -radius; k <= radius; ++k) {
        const int r = y + k < 0 ? 0 : y + k < height ? y + k : height - 1;
        const wp::vec2f* const row = sums.data + ((size_t)n * height + r) * width + x0;
        for (int j = 0; j < columns; ++j) {
            total[j] += row[j].c[0];
            known[j] += row[j].c[1];
        }
    }
    const size_t at = (size_t)line * width + x0;
    for (int j = 0; j < columns; ++j)
        details.data[at + j] = images.data[at + j] - total[j] / (known[j] > 1.f ? known[j] : 1.f);
"""


@once
def _shrink_kernel(channels: int, stored: Any, block: int) -> Any:
    stored_pixel = pixel_type(channels, stored)

    @wp.func_native(code(_SHRINK, BLOCK=block, CHANNELS=channels))
    def shrink_row(
        views: wp.array3d(dtype=stored_pixel),
        chosen: wp.array(dtype=int),
        valid: wp.array3d(dtype=float),
        scale: float,
        factor: int,
        line: int,
        x0: int,
        images: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_shrink_{channels}_{stored.__name__}_{block}", enable_backward=False)
    def shrink_kernel(
        views: wp.array3d(dtype=stored_pixel),
        chosen: wp.array(dtype=int),
        valid: wp.array3d(dtype=float),
        scale: float,
        factor: int,
        row: int,
        lanes: int,
        images_out: wp.array3d(dtype=float),
    ):
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), images_out.shape[2], lanes * wp.static(block)):
            shrink_row(views, chosen, valid, scale, factor, row + i / lanes, x, images_out)

    return shrink_kernel


@once
def _kernels(block: int) -> SimpleNamespace:
    """All others: they know fields only."""
    module = f"lfgpu_range_search_{block}"

    @wp.func_native(code(_SHRINK_AGAIN, BLOCK=block))
    def shrink_row(
        images: wp.array3d(dtype=float), factor: int, line: int, x0: int, smaller: wp.array3d(dtype=float)
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def shrink_kernel(
        images: wp.array3d(dtype=float), factor: int, row: int, lanes: int, smaller_out: wp.array3d(dtype=float)
    ):
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), smaller_out.shape[2], lanes * wp.static(block)):
            shrink_row(images, factor, row + i / lanes, x, smaller_out)

    @wp.func_native(code(_ROW_SUMS, BLOCK=block))
    def add_row(images: wp.array3d(dtype=float), window: int, line: int, x0: int, sums: wp.array3d(dtype=wp.vec2f)): ...

    @wp.kernel(module=module, enable_backward=False)
    def sums_kernel(
        images: wp.array3d(dtype=float), window: int, row: int, lanes: int, sums_out: wp.array3d(dtype=wp.vec2f)
    ):
        """Sums along the rows, and how many pixels they are of."""
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), images.shape[2], lanes * wp.static(block)):
            add_row(images, window, row + i / lanes, x, sums_out)

    @wp.func_native(code(_SUBTRACT, BLOCK=block))
    def subtract(
        images: wp.array3d(dtype=float),
        sums: wp.array3d(dtype=wp.vec2f),
        window: int,
        line: int,
        x0: int,
        details: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def details_kernel(
        images: wp.array3d(dtype=float),
        sums: wp.array3d(dtype=wp.vec2f),
        window: int,
        row: int,
        lanes: int,
        details_out: wp.array3d(dtype=float),
    ):
        """Sums down the columns, and what their mean leaves."""
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), images.shape[2], lanes * wp.static(block)):
            subtract(images, sums, window, row + i / lanes, x, details_out)

    @wp.func_native(code(_DIFFERENCES, BLOCK=block))
    def add_differences(
        details: wp.array3d(dtype=float),
        reference: int,
        shifts: wp.array2d(dtype=wp.vec4f),
        views: wp.array(dtype=int),
        ends: wp.array(dtype=int),
        first: int,
        line: int,
        x0: int,
        sums: wp.array3d(dtype=wp.vec2f),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def differences_kernel(
        details: wp.array3d(dtype=float),
        reference: int,
        shifts: wp.array2d(dtype=wp.vec4f),
        views: wp.array(dtype=int),
        ends: wp.array(dtype=int),
        first: int,
        row: int,
        lanes: int,
        sums_out: wp.array3d(dtype=wp.vec2f),
    ):
        """Differences of each side at the disparities from `first` on: their sums over views, and how many they are."""
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), details.shape[2], lanes * wp.static(block)):
            add_differences(details, reference, shifts, views, ends, first, row + i / lanes, x, sums_out)

    @wp.func_native(code(_COSTS, BLOCK=block, UNSEEN=f"{UNSEEN}f"))
    def add_boxes(
        sums: wp.array3d(dtype=wp.vec2f),
        ends: wp.array(dtype=int),
        lines: wp.array(dtype=int),
        first: int,
        line: int,
        x0: int,
        volume: wp.array4d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def costs_kernel(
        sums: wp.array3d(dtype=wp.vec2f),
        ends: wp.array(dtype=int),
        lines: wp.array(dtype=int),
        first: int,
        row: int,
        lanes: int,
        volume_out: wp.array4d(dtype=float),
    ):
        """The least mean over 3 x 3 pixels of the sides of each line."""
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), volume_out.shape[3], lanes * wp.static(block)):
            add_boxes(sums, ends, lines, first, row + i / lanes, x, volume_out)

    @wp.func_native(code(_DISTINCT, BLOCK=block, UNSEEN=f"{UNSEEN}f"))
    def find_minimum(volume: wp.array4d(dtype=float), apart: int, y: int, x0: int, found: wp.array3d(dtype=float)): ...

    @wp.kernel(module=module, enable_backward=False)
    def distinct_kernel(
        volume: wp.array4d(dtype=float), apart: int, row: int, lanes: int, found_out: wp.array3d(dtype=float)
    ):
        i = wp.tid()
        for x in range(i % lanes * wp.static(block), volume.shape[3], lanes * wp.static(block)):
            find_minimum(volume, apart, row + i / lanes, x, found_out)

    return SimpleNamespace(
        shrink=shrink_kernel,
        sums=sums_kernel,
        details=details_kernel,
        differences=differences_kernel,
        costs=costs_kernel,
        distinct=distinct_kernel,
    )


def shrink(views: Any, chosen: Sequence[int], valid: Any, *, scale: float, factor: int, images_out: Any) -> None:
    kernel = _shrink_kernel(views.dtype._length_, views.dtype._wp_scalar_type_, _block(views.device))
    line = indices(tuple(int(index) for index in chosen), views.device.alias)
    count, height, width = images_out.shape
    _launch_lines(kernel, [views, line, valid, scale, factor], images_out, count * height, width)


def details(shape: Sequence[int], device: str, *, factor: int, window: int) -> Details:
    start()
    n, height, width = shape[0], shape[1] // factor, shape[2] // factor
    smaller = wp.empty((n, height, width), dtype=float, device=device)
    sums = wp.empty((n, height, width), dtype=wp.vec2f, device=device)
    kernels = _kernels(_block(smaller.device))

    def evaluate(images: Any, details_out: Any) -> None:
        if factor > 1:
            _launch_lines(kernels.shrink, [images, factor], smaller, n * height, width)
            images = smaller
        _launch_lines(kernels.sums, [images, window], sums, n * height, width)
        _launch_lines(kernels.details, [images, sums, window], details_out, n * height, width)

    return evaluate


# --- costs ---

_DIFFERENCES = """
    const int height = details.shape[1], width = details.shape[2], sides = ends.shape[0] - 1;
    const int slice = line / height, y = line - slice * height, side = slice % sides, label = first + slice / sides;
    const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
    const size_t plane = (size_t)height * width;
    const float* const image = details.data + reference * plane + (size_t)y * width + x0;
    float total[BLOCK] = {}, parts[BLOCK] = {};
    for (int k = ends.data[side]; k < ends.data[side + 1]; ++k) {
        const wp::vec4f shift = shifts.data[(size_t)label * views.shape[0] + k];
        const int dx = (int)shift.c[0], dy = (int)shift.c[1], right = shift.c[2] > 0.f, down = shift.c[3] > 0.f;
        if (y + dy < 0 || y + dy + down >= height) continue;
        const int begin = -dx - x0 > 0 ? -dx - x0 : 0;
        const int end = width - dx - right - x0 < columns ? width - dx - right - x0 : columns;
        const float* const upper = details.data + views.data[k] * plane + (long long)(y + dy) * width + x0 + dx;
        const float* const lower = upper + width;
        const float ax = shift.c[2], ay = shift.c[3];
        auto add = [&](auto shown) {
            for (int j = begin; j < end; ++j) {
                const float difference = shown(j) - image[j];
                const bool is_known = difference == difference;
                total[j] += is_known ? difference < 0.f ? -difference : difference : 0.f;
                parts[j] += is_known ? 1.f : 0.f;
            }
        };
        // What has no share is not looked at: it may be unknown, or outside.
        auto along = [&](const float* row, int j) { return row[j] + ax * (row[j + right] - row[j]); };
        if (!down) add([&](int j) { return along(upper, j); });
        else add([&](int j) { return along(upper, j) + ay * (along(lower, j) - along(upper, j)); });
    }
    wp::vec2f* const out = sums.data + (size_t)line * width + x0;
    for (int j = 0; j < columns; ++j) {
        out[j].c[0] = total[j];
        out[j].c[1] = parts[j];
    }
"""

_COSTS = """
    const int count = volume.shape[1], height = volume.shape[2], width = volume.shape[3], sides = ends.shape[0] - 1;
    const int slice = line / height, y = line - slice * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
    const int above = y > 0 ? y - 1 : 0, below = y + 1 < height ? y + 1 : y;
    for (int m = 0; m + 1 < lines.shape[0]; ++m) {
        float* const out = volume.data + (((size_t)m * count + first + slice) * height + y) * width + x0;
        float least[BLOCK];
        for (int j = 0; j < BLOCK; ++j) least[j] = UNSEEN;
        for (int side = lines.data[m]; side < lines.data[m + 1]; ++side) {
            const wp::vec2f* const from = sums.data + ((size_t)slice * sides + side) * height * width + x0;
            float total[BLOCK + 2] = {}, parts[BLOCK + 2] = {};
            const int begin = x0 > 0 ? -1 : 0, end = x0 + columns < width ? columns + 1 : columns;
            for (int r = above; r <= below; ++r) {
                const wp::vec2f* const row = from + (size_t)r * width;
                for (int j = begin; j < end; ++j) {
                    total[j + 1] += row[j].c[0];
                    parts[j + 1] += row[j].c[1];
                }
            }
            const float needed = 4.5f * (ends.data[side + 1] - ends.data[side]);
            for (int j = 0; j < BLOCK; ++j) {
                const float part = parts[j] + parts[j + 1] + parts[j + 2];
                const float mean = (total[j] + total[j + 1] + total[j + 2]) / (part > 1.f ? part : 1.f);
                least[j] = part >= needed && mean < least[j] ? mean : least[j];
            }
        }
        for (int j = 0; j < columns; ++j) out[j] = least[j];
    }
"""


class _SideCosts:
    """Which views are shifted by how much, side by side, and room for the sums of some disparities."""

    def __init__(
        self,
        shape: Sequence[int],
        shifts: NDArray[np.float64],
        lines: Sequence[Sequence[Sequence[int]]],
        device: str,
        reference: int,
    ) -> None:
        sides = [side for line in lines for side in line]
        views = np.concatenate([np.asarray(side, np.int64) for side in sides])
        self._reference, (_, self._height, self._width) = reference, shape
        self._sides, self._count = len(sides), len(shifts)
        self._views = wp.array(views.astype(np.int32), dtype=int, device=device)
        self._ends = wp.array(np.cumsum([0, *map(len, sides)], dtype=np.int32), dtype=int, device=device)
        self._lines = wp.array(np.cumsum([0, *map(len, lines)], dtype=np.int32), dtype=int, device=device)
        chosen = shifts[:, views]
        whole = np.floor(chosen)
        shift = np.concatenate([whole, chosen - whole], axis=2).astype(np.float32)
        self._shifts = wp.array(shift, dtype=wp.vec4f, device=device)
        place = self._shifts.device
        self._kernels, self._at_once = _kernels(_block(place)), 1 if place.is_cpu else min(_AT_ONCE, self._count)
        room = (len(slices(place, self._count)), self._at_once * self._sides, self._height * self._width)
        self._room = wp.empty(room, dtype=wp.vec2f, device=device)

    def __call__(self, details: Any, volume_out: Any) -> None:
        kernels, place = self._kernels, self._shifts.device
        lanes = 1 if place.is_cpu else self._width
        check_size(self._at_once * self._sides * self._height * lanes)
        load(place, kernels.differences, kernels.costs)

        def some(k: int, begin: int, end: int) -> None:
            for first in range(begin, end, self._at_once):
                rows = min(self._at_once, end - first) * self._height
                room = self._room[k : k + 1]
                compared = [details, self._reference, self._shifts, self._views, self._ends, first, 0, lanes]
                launch(kernels.differences, rows * self._sides * lanes, compared, [room], device=place)
                added = [room, self._ends, self._lines, first, 0, lanes]
                launch(kernels.costs, rows * lanes, added, [volume_out], device=place)

        in_slices(place, self._count, some)


def side_costs(
    shape: Sequence[int],
    offsets: NDArray[Any],
    lines: Sequence[Sequence[Sequence[int]]],
    device: str,
    *,
    reference: int,
    first: float,
    step: float,
    count: int,
) -> SideCosts:
    start()
    return _SideCosts(shape, sweep_shifts(offsets, Disparities(first, step, count)), lines, device, reference)


# --- minima ---

_DISTINCT = """
    const int m = volume.shape[0], count = volume.shape[1], height = volume.shape[2], width = volume.shape[3];
    const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
    const size_t plane = (size_t)height * width, at = (size_t)y * width + x0;
    const float* const costs = volume.data + at;
    const float* const second = costs + (m - 1) * count * plane;  // of the second line, if there is one
    auto mean = [&](int l, int j) {
        const float a = costs[l * plane + j], b = second[l * plane + j];
        return 0.5f * ((a < 1.f ? a : 1.f) + (b < 1.f ? b : 1.f));
    };
    float least[BLOCK], most[BLOCK], others[BLOCK];
    int places[BLOCK];
    for (int j = 0; j < columns; ++j) {
        least[j] = most[j] = mean(0, j);
        places[j] = 0;
        others[j] = UNSEEN;
    }
    for (int l = 1; l < count; ++l)
        for (int j = 0; j < columns; ++j) {
            const float cost = mean(l, j);
            places[j] = cost < least[j] ? l : places[j];
            least[j] = cost < least[j] ? cost : least[j];
            most[j] = cost > most[j] ? cost : most[j];
        }
    for (int l = 0; l < count; ++l)
        for (int j = 0; j < columns; ++j) {
            const float cost = mean(l, j);
            const bool away = l > places[j] + apart || l < places[j] - apart;
            others[j] = away && cost < others[j] ? cost : others[j];
        }
    float* const out = found.data + at;
    for (int j = 0; j < columns; ++j) {
        const int k = places[j];
        const bool inner = k > 0 && k < count - 1;
        float t = 0.f, worst = UNSEEN;
        if (inner) {
            const float down = least[j] - mean(k - 1, j), up = mean(k + 1, j) - least[j], bend = up - down;
            t = bend > 1e-9f ? -(up + down) / (2.f * bend) : 0.f;
            t = t < -1.f ? -1.f : t > 1.f ? 1.f : t;
            const float a = costs[k * plane + j], b = second[k * plane + j];
            worst = a > b ? a : b;
        }
        out[j] = k + t;
        out[plane + j] = least[j];
        out[2 * plane + j] = most[j] - least[j];
        out[3 * plane + j] = others[j] < UNSEEN ? others[j] - least[j] : UNSEEN;
        out[4 * plane + j] = worst;
    }
"""


def distinct_minimum(volume: Any, *, apart: int, found_out: Any) -> None:
    kernel = _kernels(_block(volume.device)).distinct
    _launch_lines(kernel, [volume, apart], found_out, volume.shape[2], volume.shape[3])
