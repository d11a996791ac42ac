"""What comes near in each view; `kernels/reference/alignment.py` says what that is.

The z-buffers have a border, so that what lands beyond the frame comes near, too. The plan has one for each slice of the
views on a CPU, and as many as fit into the cache on a GPU.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import warp as wp

from lfgpu.contract import ZBuffer

from .splat import as_offsets
from .threads import check_size, in_slices, launch, load, once, slices

wp.set_module_options({"enable_backward": False})

_NOWHERE = -1e6  # the disparity of what nothing comes near
_BUFFER = 20 * 2**20  # bytes

# A CPU takes the window outside and pixels inside, many at a time.
_LAND = """
    constexpr int CHUNK = 128;
    const float du = offsets.data[first + n].c[0], dv = offsets.data[first + n].c[1];
    const int height = disparity.shape[0], width = disparity.shape[1];
    const int wide = width + 2 * border, high = height + 2 * border;
    float* const front = fronts.data + (size_t)n * high * wide;
    for (int begin = 0; begin < width; begin += CHUNK) {
        const float* const ds = disparity.data + (size_t)y * width + begin;
        const int count = wp::min(CHUNK, width - begin);
        int places[CHUNK];
        for (int i = 0; i < count; ++i) {
            // The shift is split before the column is added: a small number keeps its digits.
            const float shift_x = -ds[i] * du, shift_y = -ds[i] * dv;
            const float whole_x = floorf(shift_x), whole_y = floorf(shift_y);
            const float x = whole_x + (shift_x - whole_x >= 0.5f ? 1.f : 0.f) + (float)(begin + i + border);
            const float to_y = whole_y + (shift_y - whole_y >= 0.5f ? 1.f : 0.f) + (float)(y + border);
            const bool inside = (x >= 0.f) & (x < (float)wide) & (to_y >= 0.f) & (to_y < (float)high);
            places[i] = inside ? (int)to_y * wide + (int)x : -1;
        }
        for (int i = 0; i < count; ++i)
            if (places[i] >= 0 && front[places[i]] < ds[i]) front[places[i]] = ds[i];
    }
"""

_LOOK_AROUND = """
    constexpr int ROOM = 256;
    const int height = nearest.shape[1], width = nearest.shape[2], side = 2 * reach + 3, wide = width + side - 1;
    const float* __restrict__ const front = fronts.data + (size_t)n * (height + side - 1) * wide + (size_t)y * wide;
    float* __restrict__ const out = nearest.data + ((size_t)n * height + y) * width;
    // Down the columns first, and then along the row.
    float highest[ROOM];
    for (int begin = 0, most = ROOM - 2 * reach; begin < width; begin += most) {
        const int many = width - begin < most ? width - begin : most;
        for (int k = 0; k < many + 2 * reach; ++k) highest[k] = NOWHERE;
        for (int j = 1; j < side - 1; ++j) {
            const float* __restrict__ const row = front + j * wide + 1 + begin;
            for (int k = 0; k < many + 2 * reach; ++k) highest[k] = highest[k] < row[k] ? row[k] : highest[k];
        }
        for (int k = 0; k < many; ++k) out[begin + k] = highest[k];
        for (int i = 1; i <= 2 * reach; ++i)
            for (int k = 0; k < many; ++k)
                out[begin + k] = out[begin + k] < highest[k + i] ? highest[k + i] : out[begin + k];
    }
    for (int x = 0; x < width; ++x)
        if (out[x] <= NOWHERE)
            for (int j = 0; j < side; ++j)
                for (int i = 0; i < side; ++i) out[x] = wp::max(out[x], front[j * wide + x + i]);
"""

# A thread of a GPU has a pixel, and the views one after the other. As bits that are ordered as the floats are, 0 is
# less than any disparity: memory is cleared the fastest way, and the nearest disparity is found by one operation.

_LAND_PIXEL = """
    const float d = disparity.data[(size_t)y * width + x];
    const int bits = __float_as_int(d), wide = width + 2 * BORDER, high = disparity.shape[0] + 2 * BORDER;
    const unsigned key = bits < 0 ? ~(unsigned)bits : (unsigned)bits | 0x80000000u;
    for (int n = 0; n < count; ++n) {
        // The shift is split before the column is added: a small number keeps its digits.
        const float shift_x = -d * offsets.data[n].c[0], shift_y = -d * offsets.data[n].c[1];
        const float whole_x = floorf(shift_x), whole_y = floorf(shift_y);
        const float to_x = whole_x + (shift_x - whole_x >= 0.5f ? 1.f : 0.f) + (float)(x + BORDER);
        const float to_y = whole_y + (shift_y - whole_y >= 0.5f ? 1.f : 0.f) + (float)(y + BORDER);
        if (to_x >= 0.f && to_x < (float)wide && to_y >= 0.f && to_y < (float)high)
            atomicMax(keys.data + ((size_t)n * high + (int)to_y) * wide + (int)to_x, key);
    }
"""

_LOOK_AROUND_PIXEL = """
    constexpr int SIDE = 2 * BORDER + 1;
    const int height = nearest.shape[1], wide = width + SIDE - 1;
    for (int n = 0; n < nearest.shape[0]; ++n) {
        const unsigned* const front = keys.data + ((size_t)n * (height + SIDE - 1) + y) * wide + x;
        unsigned key = 0u;
        #pragma unroll
        for (int j = 1; j < SIDE - 1; ++j)
            #pragma unroll
            for (int i = 1; i < SIDE - 1; ++i) key = max(key, front[j * wide + i]);
        if (key == 0u)
            for (int j = 0; j < SIDE; ++j)
                for (int i = 0; i < SIDE; ++i) key = max(key, front[j * wide + i]);
        const float found = __int_as_float((int)(key >> 31 ? key & 0x7fffffffu : ~key));
        nearest.data[((size_t)n * height + y) * width + x] = key ? found : NOWHERE;
    }
"""


@wp.func_native(_LAND)
def _land_row(
    disparity: wp.array2d(dtype=float),
    offsets: wp.array(dtype=wp.vec2f),
    first: int,
    border: int,
    n: int,
    y: int,
    fronts: wp.array(dtype=float),
): ...


@wp.func_native(_LOOK_AROUND.replace("NOWHERE", f"{_NOWHERE}f"))
def _look_around_row(fronts: wp.array(dtype=float), reach: int, n: int, y: int, nearest: wp.array3d(dtype=float)): ...


@wp.func_native(f"for (int k = 0; k < fronts.shape[0]; ++k) fronts.data[k] = {_NOWHERE}f;")
def _clear(fronts: wp.array(dtype=float)): ...


@wp.kernel
def _clear_kernel(fronts_out: wp.array(dtype=float)):
    _clear(fronts_out)


@wp.kernel
def _land_kernel(
    disparity: wp.array2d(dtype=float),
    offsets: wp.array(dtype=wp.vec2f),
    first: int,
    border: int,
    fronts: wp.array(dtype=float),
):
    i = wp.tid()
    n = i / disparity.shape[0]
    _land_row(disparity, offsets, first, border, n, i - n * disparity.shape[0], fronts)


@wp.kernel
def _look_around_kernel(fronts: wp.array(dtype=float), reach: int, nearest_out: wp.array3d(dtype=float)):
    i = wp.tid()
    n = i / nearest_out.shape[1]
    _look_around_row(fronts, reach, n, i - n * nearest_out.shape[1], nearest_out)


@once
def _gpu_kernels(border: int) -> SimpleNamespace:
    module = f"lfgpu_gpu_z_buffer_{border}"

    @wp.func_native(_LAND_PIXEL.replace("BORDER", str(border)))
    def land(
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        count: int,
        width: int,
        y: int,
        x: int,
        keys: wp.array(dtype=wp.uint32),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def land_kernel(
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        count: int,
        width: int,
        keys_out: wp.array(dtype=wp.uint32),
    ):
        i = wp.tid()
        y = i / width
        land(disparity, offsets, count, width, y, i - y * width, keys_out)

    @wp.func_native(_LOOK_AROUND_PIXEL.replace("BORDER", str(border)).replace("NOWHERE", f"{_NOWHERE}f"))
    def look_around(keys: wp.array(dtype=wp.uint32), width: int, y: int, x: int, nearest: wp.array3d(dtype=float)): ...

    @wp.kernel(module=module, enable_backward=False)
    def look_around_kernel(keys: wp.array(dtype=wp.uint32), width: int, nearest_out: wp.array3d(dtype=float)):
        i = wp.tid()
        y = i / width
        look_around(keys, width, y, i - y * width, nearest_out)

    return SimpleNamespace(land=land_kernel, look_around=look_around_kernel)


def z_buffer(shape: Sequence[int], offsets: Any, *, reach: int) -> ZBuffer:
    assert 0 <= reach <= 100, f"reach is {reach}: a row of _look_around_row has room for less than 128 on a CPU"
    (count, height, width, _), device, pairs, border = shape, offsets.device, as_offsets(offsets), reach + 1
    size = (height + 2 * border) * (width + 2 * border)
    if not device.is_cpu:
        return _gpu_z_buffer((count, height, width), pairs, border)
    room = [wp.empty(size, dtype=float, device=device) for _ in slices(device, count)]

    def find(disparity: Any, nearest_out: Any) -> None:
        load(device, _land_kernel, _clear_kernel)

        def some_views(k: int, first: int, last: int) -> None:
            for n in range(first, last):
                launch(_clear_kernel, 1, [], [room[k]], device=device)
                launch(_land_kernel, height, [disparity, pairs, n, border], [room[k]], device=device)
                launch(_look_around_kernel, height, [room[k], reach], [nearest_out[n : n + 1]], device=device)

        in_slices(device, count, some_views)

    return find


def _gpu_z_buffer(shape: tuple[int, int, int], pairs: Any, border: int) -> ZBuffer:
    (count, height, width), device, kernels = shape, pairs.device, _gpu_kernels(border)
    size = (height + 2 * border) * (width + 2 * border)
    batch = min(count, max(1, _BUFFER // (4 * size)))
    keys = wp.empty(batch * size, dtype=wp.uint32, device=device)
    check_size(height * width)

    def find(disparity: Any, nearest_out: Any) -> None:
        for first in range(0, count, batch):
            last = min(count, first + batch)
            keys.zero_()
            inputs = [disparity, pairs[first:last], last - first, width]
            launch(kernels.land, height * width, inputs, [keys], device=device)
            launch(kernels.look_around, height * width, [keys, width], [nearest_out[first:last]], device=device)

    return find
