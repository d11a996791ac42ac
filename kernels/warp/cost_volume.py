"""Cost volumes: averages of like pixels, and the least; `kernels/reference/cost_volume.py` says which."""

from typing import Any

import warp as wp

from lfgpu.contract import REDUCTION

from .threads import in_slices, launch, launch_rows, load, once, slices

wp.set_module_options({"enable_backward": False})

_BLOCK = 32  # columns that a CPU works on at a time
_SLICES = 8  # of the volume, for which a thread of a GPU reads weights once
_TILE = (8, 32)  # rows and columns of pixels of a block on a GPU

# On a CPU the weights of a block of columns are gathered once, for all slices of the volume: where they lie, each in a
# picture of its own, they would drive each other out of the cache.

_AVERAGE_ROWS = """
    const int height = volume.shape[1], width = volume.shape[2], count = volume.shape[0];
    const size_t size = (size_t)height * width;
    float* __restrict__ gathered = room.data;
    for (int y = first; y < last; ++y) {
        const int top = y < RADIUS ? -y : -RADIUS, bottom = height - 1 - y < RADIUS ? height - 1 - y : RADIUS;
        for (int x0 = 0; x0 < width; x0 += BLOCK) {
            const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
            const bool inner = x0 >= RADIUS && x0 + BLOCK + RADIUS <= width;
            float total[BLOCK] = {};
            float* to = gathered;
            for (int dy = top; dy <= bottom; ++dy)
                for (int dx = -RADIUS; dx <= RADIUS; ++dx, to += BLOCK) {
                    // Of each pair the second pixel finds the weight at the first.
                    const bool after = dy > 0 || (dy == 0 && dx > 0), itself = dy == 0 && dx == 0;
                    const int k = (after ? dy * SIDE + dx : -dy * SIDE - dx) - 1;
                    const long long from = after ? y * width + x0 : (y + dy) * width + x0 + dx;
                    for (int j = 0; j < BLOCK; ++j) {
                        const bool inside = j < columns && x0 + j + dx >= 0 && x0 + j + dx < width;
                        to[j] = !inside ? 0.f : itself ? 1.f : weights.data[k * (long long)size + from + j];
                        total[j] += to[j];
                    }
                }
            for (int l = 0; l < count; ++l) {
                const float* __restrict__ slice = volume.data + l * size;
                float* __restrict__ result = average.data + l * size + y * width + x0;
                const float* w = gathered;
                if (inner) {
                    float sum[BLOCK] = {};
                    for (int dy = top; dy <= bottom; ++dy) {
                        const float* other = slice + (y + dy) * width + x0 - RADIUS;
                        for (int dx = 0; dx < SIDE; ++dx, ++other, w += BLOCK)
                            for (int j = 0; j < BLOCK; ++j) sum[j] += w[j] * other[j];
                    }
                    for (int j = 0; j < BLOCK; ++j) result[j] = sum[j] / total[j];
                } else {
                    float sum[BLOCK] = {};
                    for (int dy = top; dy <= bottom; ++dy)
                        for (int dx = -RADIUS; dx <= RADIUS; ++dx, w += BLOCK) {
                            const float* other = slice + (y + dy) * width;
                            const int begin = x0 + dx < 0 ? -x0 - dx : 0;
                            const int end = x0 + columns + dx > width ? width - x0 - dx : columns;
                            for (int j = begin; j < end; ++j) sum[j] += w[j] * other[x0 + dx + j];
                        }
                    for (int j = 0; j < columns; ++j) result[j] = sum[j] / total[j];
                }
            }
        }
    }
"""

_AVERAGE_PIXEL = """
    const int height = volume.shape[1], width = volume.shape[2], p = y * width + x;
    if (y >= height || x >= width) return;
    const long long size = (long long)height * width;
    const float* slices[SLICES];
    float sums[SLICES], total = 1.f;
    #pragma unroll
    for (int s = 0; s < SLICES; ++s) {
        slices[s] = volume.data + min(first + s, last - 1) * size + p;  // the last one again where there are fewer
        sums[s] = slices[s][0];
    }
    const bool inner = x >= RADIUS && x < width - RADIUS;
    for (int dy = -RADIUS; dy <= RADIUS; ++dy) {
        if ((unsigned)(y + dy) >= (unsigned)height) continue;
        #pragma unroll
        for (int dx = -RADIUS; dx <= RADIUS; ++dx) {
            if ((dy == 0 && dx == 0) || !(inner || (unsigned)(x + dx) < (unsigned)width)) continue;
            const bool after = dy > 0 || (dy == 0 && dx > 0);
            const int k = (after ? dy * SIDE + dx : -dy * SIDE - dx) - 1, q = dy * width + dx;
            const float w = weights.data[k * size + p + (after ? 0 : q)];
            total += w;
    #pragma unroll
            for (int s = 0; s < SLICES; ++s) sums[s] += w * slices[s][q];
        }
    }
    #pragma unroll
    for (int s = 0; s < SLICES; ++s)
        if (first + s < last) average.data[(first + s) * size + p] = sums[s] / total;
"""


def code(text: str, **numbers: int | str) -> str:
    """Native code with numbers in the place of their names."""
    for name, value in numbers.items():
        text = text.replace(name, str(value))
    return text


@once
def _rows_kernel(radius: int) -> Any:
    """The average on a CPU, of some rows."""

    @wp.func_native(code(_AVERAGE_ROWS, RADIUS=radius, SIDE=2 * radius + 1, BLOCK=_BLOCK))
    def average_rows(
        weights: wp.array3d(dtype=float),
        volume: wp.array3d(dtype=float),
        first: int,
        last: int,
        room: wp.array(dtype=float),
        average: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_cost_volume_{radius}", enable_backward=False)
    def rows_kernel(
        weights: wp.array3d(dtype=float),
        volume: wp.array3d(dtype=float),
        first: int,
        last: int,
        room: wp.array(dtype=float),
        average_out: wp.array3d(dtype=float),
    ):
        average_rows(weights, volume, first, last, room, average_out)

    return rows_kernel


@once
def _pixels_kernel(radius: int) -> Any:
    """The average on a GPU."""

    @wp.func_native(code(_AVERAGE_PIXEL, RADIUS=radius, SIDE=2 * radius + 1, SLICES=_SLICES))
    def average_pixel(
        weights: wp.array3d(dtype=float),
        volume: wp.array3d(dtype=float),
        y: int,
        x: int,
        first: int,
        last: int,
        average: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_gpu_cost_volume_{radius}", enable_backward=False)
    def pixels_kernel(
        weights: wp.array3d(dtype=float), volume: wp.array3d(dtype=float), average_out: wp.array3d(dtype=float)
    ):
        i = wp.tid()
        block = i / wp.static(_TILE[0] * _TILE[1])
        thread = i - block * wp.static(_TILE[0] * _TILE[1])
        count = volume.shape[0]
        parts = (count + wp.static(_SLICES - 1)) / wp.static(_SLICES)
        tile = block / parts  # blocks of the same pixels follow each other and find their weights in the cache
        part = block - tile * parts
        columns = (volume.shape[2] + wp.static(_TILE[1] - 1)) / wp.static(_TILE[1])
        row = tile / columns
        y = row * wp.static(_TILE[0]) + thread / wp.static(_TILE[1])
        x = (tile - row * columns) * wp.static(_TILE[1]) + thread % wp.static(_TILE[1])
        average_pixel(weights, volume, y, x, count * part / parts, count * (part + 1) / parts, average_out)

    return pixels_kernel


def nlm_average(weights: Any, volume: Any, *, window: int, average_out: Any) -> None:
    (count, height, width), device = volume.shape, volume.device
    if device.is_cuda:
        tiles = -(-height // _TILE[0]) * -(-width // _TILE[1])
        block = _TILE[0] * _TILE[1]
        dim = tiles * -(-count // _SLICES) * block
        kernel = _pixels_kernel(window // 2)
        launch(kernel, dim, [weights, volume], [average_out], device=device, block_dim=block)
        return
    kernel = _rows_kernel(window // 2)
    load(device, kernel)
    room = wp.empty((len(slices(device, height)), window * window * _BLOCK), dtype=float, device=device)

    def some_rows(part: int, first: int, last: int) -> None:
        launch(kernel, 1, [weights, volume, first, last, room[part]], [average_out], device=device)

    in_slices(device, height, some_rows)


# Along a row, four pixels lie on one of the reduced volume, between the centres of this one and its neighbours.

_ADD_REDUCED = """
    const int height = volume.shape[1], width = volume.shape[2], rows = reduced.shape[1], columns = reduced.shape[2];
    const float at = ((float)y + 0.5f) / REDUCTION - 0.5f;
    const float place = at < 0.f ? 0.f : at > rows - 1 ? (float)(rows - 1) : at;
    const int upper = (int)place, lower = upper + 1 < rows ? upper + 1 : upper;
    const float down = weight * (place - upper), up = weight - down;
    const float* __restrict__ const share_above = shares.data + (size_t)upper * columns;
    const float* __restrict__ const share_below = shares.data + (size_t)lower * columns;
    for (int l = 0; l < volume.shape[0]; ++l) {
        const float* __restrict__ const above = reduced.data + ((size_t)l * rows + upper) * columns;
        const float* __restrict__ const below = reduced.data + ((size_t)l * rows + lower) * columns;
        float* __restrict__ const out = volume.data + ((size_t)l * height + y) * width;
        for (int k = lane; k * REDUCTION < width; k += lanes) {
            const int here = k < columns ? k : columns - 1;
            const int before = k < 1 ? 0 : k - 1 < here ? k - 1 : here, after = k + 1 < columns ? k + 1 : columns - 1;
            auto at = [&](int i) { return up * share_above[i] * above[i] + down * share_below[i] * below[i]; };
            const float left = at(before), middle = at(here), right = at(after);
            #pragma unroll
            for (int j = 0; j < REDUCTION; ++j) {
                const float away = (j + 0.5f) / REDUCTION - 0.5f;
                const int x = k * REDUCTION + j;
                if (x < width) out[x] += middle + (away < 0.f ? -away * (left - middle) : away * (right - middle));
            }
        }
    }
"""


@wp.func_native(code(_ADD_REDUCED, REDUCTION=REDUCTION))
def _add_row(
    reduced: wp.array3d(dtype=float),
    shares: wp.array2d(dtype=float),
    weight: float,
    y: int,
    lane: int,
    lanes: int,
    volume: wp.array3d(dtype=float),
): ...


@wp.kernel(module="lfgpu_add_reduced", enable_backward=False)
def _add_kernel(
    reduced: wp.array3d(dtype=float),
    shares: wp.array2d(dtype=float),
    weight: float,
    row: int,
    lanes: int,
    volume_inout: wp.array3d(dtype=float),
):
    i = wp.tid()
    _add_row(reduced, shares, weight, row + i / lanes, i % lanes, lanes, volume_inout)


def add_reduced(reduced: Any, shares: Any, *, weight: float, volume_inout: Any) -> None:
    launch_rows(_add_kernel, [reduced, shares, weight], volume_inout)


_LEAST = """
    const int width = volume.shape[2], count = volume.shape[0];
    const size_t size = (size_t)volume.shape[1] * width;
    const int columns = width - x < BLOCK ? width - x : BLOCK;
    const float* const costs = volume.data + (size_t)y * width + x;
    float* const out = least.data + (size_t)y * width + x;
    float found[BLOCK];
    for (int j = 0; j < columns; ++j) found[j] = costs[j];
    for (int l = 1; l < count; ++l)
        for (int j = 0; j < columns; ++j) found[j] = costs[l * size + j] < found[j] ? costs[l * size + j] : found[j];
    for (int j = 0; j < columns; ++j) out[j] = found[j];
"""


@once
def _least_kernel(block: int) -> Any:
    """The least costs of `block` columns at a time."""

    @wp.func_native(code(_LEAST, BLOCK=block))
    def least_of(volume: wp.array3d(dtype=float), y: int, x: int, least: wp.array2d(dtype=float)): ...

    @wp.kernel(module=f"lfgpu_least_{block}", enable_backward=False)
    def least_kernel(volume: wp.array3d(dtype=float), row: int, lanes: int, least_out: wp.array2d(dtype=float)):
        i = wp.tid()
        y = row + i / lanes
        for x in range(i % lanes * wp.static(block), volume.shape[2], lanes * wp.static(block)):
            least_of(volume, y, x, least_out)

    return least_kernel


def least_costs(volume: Any, *, least_out: Any) -> None:
    launch_rows(_least_kernel(_BLOCK if volume.device.is_cpu else 1), [volume], least_out)


_LOWEST = """
    const int width = volume.shape[2], count = volume.shape[0];
    const size_t size = (size_t)volume.shape[1] * width;
    const int columns = width - x < BLOCK ? width - x : BLOCK;
    const float* const costs = volume.data + (size_t)y * width + x;
    float least[BLOCK];
    int places[BLOCK];
    for (int j = 0; j < columns; ++j) {
        least[j] = costs[j];
        places[j] = 0;
    }
    for (int l = 1; l < count; ++l)
        for (int j = 0; j < columns; ++j) {
            const float cost = costs[l * size + j];
            const bool less = cost < least[j];
            places[j] = less ? l : places[j];
            least[j] = less ? cost : least[j];
        }
    for (int j = 0; j < columns; ++j) {
        const int k = places[j] < 1 ? 1 : places[j] > count - 2 ? count - 2 : places[j];
        const float* const here = costs + k * size + j;
        // Differences first: what the costs have in common has no part in their rounding.
        const float down = here[0] - *(here - size), up = here[size] - here[0], bend = up - down;
        float t = bend > 1e-9f ? -(up + down) / (2.f * bend) : 0.f;
        t = t < -1.f ? -1.f : t > 1.f ? 1.f : t;
        disparity.data[(size_t)y * width + x + j] = first + step * (k + t);
    }
"""


@once
def _lowest_kernel(block: int) -> Any:
    """The least cost of `block` columns at a time."""

    @wp.func_native(code(_LOWEST, BLOCK=block))
    def lowest_of(
        volume: wp.array3d(dtype=float), y: int, x: int, first: float, step: float, disparity: wp.array2d(dtype=float)
    ): ...

    @wp.kernel(module=f"lfgpu_lowest_{block}", enable_backward=False)
    def lowest_kernel(
        volume: wp.array3d(dtype=float),
        first: float,
        step: float,
        row: int,
        lanes: int,
        disparity_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        y = row + i / lanes
        for x in range(i % lanes * wp.static(block), volume.shape[2], lanes * wp.static(block)):
            lowest_of(volume, y, x, first, step, disparity_out)

    return lowest_kernel


def winner_takes_all(volume: Any, *, first: float, step: float, disparity_out: Any) -> None:
    launch_rows(_lowest_kernel(_BLOCK if volume.device.is_cpu else 1), [volume, first, step], disparity_out)
