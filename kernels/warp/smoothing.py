"""Views for comparisons: means of pixels that look alike, and reduced views. `kernels/reference/smoothing.py` says why.

On a CPU a thread goes down the rows of a view and keeps the last few, channel by channel, in rings; what is done to a
row is then what vector units do. On a GPU a block has a tile of a view, and what is around it, in shared memory.
"""

import math
from typing import Any

import warp as wp

from lfgpu.contract import REDUCTION, SMOOTHING_REACH, WHITE

from .cost_volume import code
from .memory import pixel_type
from .threads import check_size, in_slices, lanes, launch, load, once, slices

wp.set_module_options({"enable_backward": False})

_SPREAD = 8.0  # pixels²: twice the variance of the Gaussian over places
_TILE = (16, 32)  # rows and columns of a block on a GPU
_PIXELS = 2  # of a column, that a thread has
_THREADS = _TILE[0] // _PIXELS * _TILE[1]  # of such a block
_RING = 16  # rows that a thread of a CPU keeps
_LANES = 16  # columns that it works on at a time

_NEAR = ", ".join(f"{math.exp(-(k**2) / _SPREAD):.9e}f" for k in range(-SMOOTHING_REACH, SMOOTHING_REACH + 1))

_STORE = """
    auto stored = [](float value) {
        const float inside = value < 0.f ? 0.f : value > 1.f ? 1.f : value;
        return (unsigned short)(WHITE * inside + 0.5f);
    };
"""

_ROWS = (
    _STORE
    + """
    typedef float Some __attribute__((ext_vector_type(LANES)));
    typedef float Anywhere __attribute__((ext_vector_type(LANES), aligned(4)));
    auto some = [](const float* from) { return (Some)*(const Anywhere*)from; };
    constexpr float near[] = {NEAR};
    const int height = views.shape[1], width = views.shape[2], wide = width + 2 * (REACH + 1) + LANES;
    const float unit = 1.f / (CHANNELS * deviation * deviation);
    const size_t row = (size_t)CHANNELS * wide;
    float* const colors = room.data;                // [RING, CHANNELS, wide]: row y in ring place y % RING
    float* const guides = colors + RING * row;      // the same
    float* const knowns = guides + RING * row;      // [RING, wide]: 1 where colors are valid
    float* const counts = knowns + (size_t)RING * wide;  // [RING, wide]: the same, but 0 outside of the frame
    float* const shares = counts + (size_t)RING * wide;  // [wide]
    auto within = [](int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; };
    int colored = 0, guided = 0;                    // rows of this view that are in the rings
    for (int i = first; i < last; ++i) {
        const int n = i / height, y = i - n * height;
        const size_t view = (size_t)n * height * width;
        if (i == first || y == 0) {
            colored = within(y - REACH - 1, height);
            guided = within(y - REACH, height);
        }
        const int bottom = within(y + REACH, height);
        for (; colored <= within(bottom + 1, height); ++colored) {
            const auto* const in = views.data + view + (size_t)colored * width;
            const float* const mask = valid.data + view + (size_t)colored * width;
            float* const known = knowns + (size_t)(colored % RING) * wide + REACH + 1;
            float* const count = counts + (size_t)(colored % RING) * wide + REACH + 1;
            for (int x = 0; x < width; ++x) count[x] = known[x] = !valid.data || mask[x] != 0.f ? 1.f : 0.f;
            for (int x = 1; x <= REACH + 1; ++x) {
                count[-x] = count[width - 1 + x] = 0.f;
                known[-x] = known[0];
                known[width - 1 + x] = known[width - 1];
            }
            for (int c = 0; c < CHANNELS; ++c) {
                float* const out = colors + (colored % RING) * row + (size_t)c * wide + REACH + 1;
                for (int x = 0; x < width; ++x) out[x] = known[x] != 0.f ? scale * (float)in[x].c[c] : 0.f;
                for (int x = 1; x <= REACH + 1; ++x) {
                    out[-x] = out[0];
                    out[width - 1 + x] = out[width - 1];
                }
            }
        }
        for (; guided <= bottom; ++guided) {
            const int above = within(guided - 1, height) % RING, here = guided % RING;
            const int below = within(guided + 1, height) % RING;
            auto add = [&](const float* a, const float* b, const float* d, float* out) {
                #pragma clang loop vectorize(assume_safety)
                for (int x = 1; x < wide - 1; ++x)
                    out[x] = a[x - 1] + a[x] + a[x + 1] + b[x - 1] + b[x] + b[x + 1] + d[x - 1] + d[x] + d[x + 1];
            };
            add(knowns + (size_t)above * wide, knowns + (size_t)here * wide, knowns + (size_t)below * wide, shares);
            for (int x = 1; x < wide - 1; ++x) shares[x] = 1.f / (shares[x] > 1.f ? shares[x] : 1.f);
            for (int c = 0; c < CHANNELS; ++c) {
                const float* const channel = colors + (size_t)c * wide;
                float* const out = guides + here * row + (size_t)c * wide;
                add(channel + above * row, channel + here * row, channel + below * row, out);
                for (int x = 1; x < wide - 1; ++x) out[x] *= shares[x];
            }
        }
        // As many columns as a few registers hold, with all that is added up for them.
        const float* const guide = guides + (y % RING) * row + REACH + 1;
        const float* const known = knowns + (size_t)(y % RING) * wide + REACH + 1;
        auto* const out = smoothed.data + view + (size_t)y * width;
        const int above = y < REACH ? -y : -REACH, below = height - 1 - y < REACH ? height - 1 - y : REACH;
        for (int x = 0; x < width; x += LANES) {
            #pragma clang fp contract(fast)
            Some middle[CHANNELS], sum[CHANNELS], weights = 0.f;
            #pragma unroll
            for (int c = 0; c < CHANNELS; ++c) {
                middle[c] = some(guide + (size_t)c * wide + x);
                sum[c] = 0.f;
            }
            const Some likeness = unit * some(known + x);
            for (int dy = above; dy <= below; ++dy) {
                const size_t place = (y + dy) % RING;
                const float* const other = guides + place * row + REACH + 1 + x;
                const float* const color = colors + place * row + REACH + 1 + x;
                const float* const count = counts + place * wide + REACH + 1 + x;
                #pragma unroll
                for (int dx = -REACH; dx <= REACH; ++dx) {
                    Some unlike = 1.f;
                    #pragma unroll
                    for (int c = 0; c < CHANNELS; ++c) {
                        const Some difference = some(other + (size_t)c * wide + dx) - middle[c];
                        unlike += likeness * difference * difference;
                    }
                    const Some weight = near[dy + REACH] * near[dx + REACH] * some(count + dx) / (unlike * unlike);
                    #pragma unroll
                    for (int c = 0; c < CHANNELS; ++c) sum[c] += weight * some(color + (size_t)c * wide + dx);
                    weights += weight;
                }
            }
            for (int j = 0; j < LANES && x + j < width; ++j)
                for (int c = 0; c < CHANNELS; ++c)
                    out[x + j].c[c] = stored(weights[j] > 0.f ? sum[c][j] / weights[j] : 0.f);
        }
    }
"""
)

_PIXEL = (
    _STORE
    + """
    constexpr float near[] = {NEAR};
    constexpr int tall = ROWS + 2 * REACH, wide = COLUMNS + 2 * REACH;
    __shared__ float colors[CHANNELS][tall + 2][wide + 2], guides[CHANNELS][tall][wide];
    __shared__ float knowns[tall + 2][wide + 2], counts[tall][wide];  // 1 where valid; counts: 0 outside the frame
    const int height = views.shape[1], width = views.shape[2], threads = ROWS / PIXELS * COLUMNS;
    const long long view = (long long)n * height * width;
    const float unit = 1.f / (CHANNELS * deviation * deviation);
    for (int i = thread; i < (tall + 2) * (wide + 2); i += threads) {
        const int y = i / (wide + 2), x = i - y * (wide + 2);
        const int row = min(max(top + y - REACH - 1, 0), height - 1);
        const int column = min(max(left + x - REACH - 1, 0), width - 1);
        const long long place = view + (long long)row * width + column;
        const bool known = !valid.data || valid.data[place] != 0.f;
        knowns[y][x] = known ? 1.f : 0.f;
        const auto value = views.data[place];
        for (int c = 0; c < CHANNELS; ++c) colors[c][y][x] = known ? scale * (float)value.c[c] : 0.f;
    }
    __syncthreads();
    for (int i = thread; i < tall * wide; i += threads) {
        const int y = i / wide, x = i - y * wide, row = top + y - REACH, column = left + x - REACH;
        float share = 0.f;
        for (int dy = 0; dy < 3; ++dy)
            for (int dx = 0; dx < 3; ++dx) share += knowns[y + dy][x + dx];
        share = 1.f / max(share, 1.f);
        for (int c = 0; c < CHANNELS; ++c) {
            float sum = 0.f;
            for (int dy = 0; dy < 3; ++dy)
                for (int dx = 0; dx < 3; ++dx) sum += colors[c][y + dy][x + dx];
            guides[c][y][x] = sum * share;
        }
        const bool inside = (unsigned)row < (unsigned)height && (unsigned)column < (unsigned)width;
        counts[y][x] = inside ? knowns[y + 1][x + 1] : 0.f;
    }
    __syncthreads();
    // PIXELS of a column at once: what is around them is read once for all.
    const int y = thread / COLUMNS * PIXELS, x = thread % COLUMNS;
    float sums[PIXELS][CHANNELS] = {}, weights[PIXELS] = {}, guide[PIXELS][CHANNELS], likeness[PIXELS];
    for (int j = 0; j < PIXELS; ++j) {
        for (int c = 0; c < CHANNELS; ++c) guide[j][c] = guides[c][y + j + REACH][x + REACH];
        likeness[j] = unit * counts[y + j + REACH][x + REACH];
    }
    #pragma unroll
    for (int row = 0; row < 2 * REACH + PIXELS; ++row)
        #pragma unroll
        for (int dx = 0; dx <= 2 * REACH; ++dx) {
            float other[CHANNELS], color[CHANNELS];
            for (int c = 0; c < CHANNELS; ++c) {
                other[c] = guides[c][y + row][x + dx];
                color[c] = colors[c][y + row + 1][x + dx + 1];
            }
            const float count = counts[y + row][x + dx];
            #pragma unroll
            for (int j = 0; j < PIXELS; ++j) {
                const int dy = row - j;
                if (dy < 0 || dy > 2 * REACH) continue;
                float difference = 0.f;
                for (int c = 0; c < CHANNELS; ++c) {
                    const float apart = other[c] - guide[j][c];
                    difference += apart * apart;
                }
                const float unlike = 1.f + likeness[j] * difference;
                const float weight = __fdividef(near[dy] * near[dx] * count, unlike * unlike);
                for (int c = 0; c < CHANNELS; ++c) sums[j][c] += weight * color[c];
                weights[j] += weight;
            }
        }
    for (int j = 0; j < PIXELS; ++j) {
        if (top + y + j >= height || left + x >= width) continue;
        auto& out = smoothed.data[view + (long long)(top + y + j) * width + left + x];
        for (int c = 0; c < CHANNELS; ++c) out.c[c] = stored(weights[j] > 0.f ? sums[j][c] / weights[j] : 0.f);
    }
"""
)


def _code(text: str, channels: int) -> str:
    text = text.replace("NEAR", _NEAR)
    numbers = {"REACH": SMOOTHING_REACH, "RING": _RING, "ROWS": _TILE[0], "COLUMNS": _TILE[1], "PIXELS": _PIXELS}
    return code(text, CHANNELS=channels, WHITE=WHITE, LANES=_LANES, **numbers)


@once
def _rows_kernel(channels: int, stored: Any) -> Any:
    """Some rows of all views, on a CPU."""
    stored_pixel, smoothed_pixel = pixel_type(channels, stored), pixel_type(channels, wp.uint16)

    @wp.func_native(_code(_ROWS, channels))
    def smooth_rows(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        deviation: float,
        first: int,
        last: int,
        room: wp.array(dtype=float),
        smoothed: wp.array3d(dtype=smoothed_pixel),
    ): ...

    @wp.kernel(module=f"lfgpu_smoothing_{channels}_{stored.__name__}", enable_backward=False)
    def rows_kernel(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        deviation: float,
        first: int,
        last: int,
        room: wp.array(dtype=float),
        views_out: wp.array3d(dtype=smoothed_pixel),
    ):
        smooth_rows(views, valid, scale, deviation, first, last, room, views_out)

    return rows_kernel


@once
def _tiles_kernel(channels: int, stored: Any) -> Any:
    """A tile of a view, on a GPU."""
    stored_pixel, smoothed_pixel = pixel_type(channels, stored), pixel_type(channels, wp.uint16)

    @wp.func_native(_code(_PIXEL, channels))
    def smooth_pixel(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        deviation: float,
        n: int,
        top: int,
        left: int,
        thread: int,
        smoothed: wp.array3d(dtype=smoothed_pixel),
    ): ...

    @wp.kernel(module=f"lfgpu_gpu_smoothing_{channels}_{stored.__name__}", enable_backward=False)
    def tiles_kernel(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        deviation: float,
        views_out: wp.array3d(dtype=smoothed_pixel),
    ):
        i = wp.tid()
        tile = i / wp.static(_THREADS)
        thread = i - tile * wp.static(_THREADS)
        columns = (views.shape[2] + wp.static(_TILE[1] - 1)) / wp.static(_TILE[1])
        rows = (views.shape[1] + wp.static(_TILE[0] - 1)) / wp.static(_TILE[0])
        n = tile / (rows * columns)
        place = tile - n * rows * columns
        top = place / columns * wp.static(_TILE[0])
        left = place % columns * wp.static(_TILE[1])
        smooth_pixel(views, valid, scale, deviation, n, top, left, thread, views_out)

    tiles_kernel.module.options["fast_math"] = True  # divisions that need not look at numbers near those that underflow
    return tiles_kernel


def smooth_views(views: Any, valid: Any, *, scale: float, deviation: float, views_out: Any) -> None:
    (n, height, width), device = views.shape, views.device
    channels, stored = views.dtype._length_, views.dtype._wp_scalar_type_
    if device.is_cuda:
        dim = n * -(-height // _TILE[0]) * -(-width // _TILE[1]) * _THREADS
        check_size(dim)
        inputs = [views, valid, scale, deviation]
        launch(_tiles_kernel(channels, stored), dim, inputs, [views_out], device=device, block_dim=_THREADS)
        return
    kernel = _rows_kernel(channels, stored)
    load(device, kernel)
    wide = width + 2 * (SMOOTHING_REACH + 1) + _LANES
    per_slice = (_RING * (2 * channels + 2) + 1) * wide
    room = wp.zeros((len(slices(device, n * height)), per_slice), dtype=float, device=device)

    def some_rows(part: int, first: int, last: int) -> None:
        inputs = [views, valid, scale, deviation, first, last, room[part]]
        launch(kernel, 1, inputs, [views_out], device=device)

    in_slices(device, n * height, some_rows)


_REDUCE = (
    _STORE
    + """
    const int height = views.shape[1], width = views.shape[2], columns = reduced.shape[2];
    for (int x = lane; x < columns; x += lanes) {
        float sums[CHANNELS] = {};
        int known = 0;
        for (int dy = 0; dy < REDUCTION; ++dy)
            for (int dx = 0; dx < REDUCTION; ++dx) {
                const size_t p = ((size_t)n * height + y * REDUCTION + dy) * width + x * REDUCTION + dx;
                if (valid.data && valid.data[p] == 0.f) continue;
                for (int c = 0; c < CHANNELS; ++c) sums[c] += (float)views.data[p].c[c];
                ++known;
            }
        const size_t q = ((size_t)n * reduced.shape[1] + y) * columns + x;
        for (int c = 0; c < CHANNELS; ++c)
            reduced.data[q].c[c] = stored(known ? scale * sums[c] / known : 0.f);
        if (valid.data) counts.data[q] = known == REDUCTION * REDUCTION ? 1.f : 0.f;
    }
"""
)


@once
def _reduce_kernel(channels: int, stored: Any) -> Any:
    stored_pixel, reduced_pixel = pixel_type(channels, stored), pixel_type(channels, wp.uint16)

    @wp.func_native(code(_REDUCE, CHANNELS=channels, REDUCTION=REDUCTION, WHITE=WHITE))
    def reduce_row(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        n: int,
        y: int,
        lane: int,
        lanes: int,
        reduced: wp.array3d(dtype=reduced_pixel),
        counts: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_reduce_{channels}_{stored.__name__}", enable_backward=False)
    def reduce_kernel(
        views: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        scale: float,
        row: int,
        lanes: int,
        views_out: wp.array3d(dtype=reduced_pixel),
        valid_out: wp.array3d(dtype=float),
    ):
        """`row` and what follows it are those of all views, one after the other."""
        i = wp.tid()
        line = row + i / lanes
        n = line / views_out.shape[1]
        reduce_row(views, valid, scale, n, line - n * views_out.shape[1], i % lanes, lanes, views_out, valid_out)

    return reduce_kernel


def reduce_views(views: Any, valid: Any, *, scale: float, views_out: Any, valid_out: Any) -> None:
    kernel, device = _reduce_kernel(views.dtype._length_, views.dtype._wp_scalar_type_), views.device
    load(device, kernel)
    rows, threads = views_out.shape[0] * views_out.shape[1], lanes(views_out)
    check_size(rows * threads)

    def some_rows(_: int, first: int, last: int) -> None:
        inputs = [views, valid, scale, first, threads]
        launch(kernel, (last - first) * threads, inputs, [views_out, valid_out], device=device)

    in_slices(device, rows, some_rows)
