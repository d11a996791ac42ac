"""What comes near in each view, and how well the views agree; `kernels/reference/alignment.py` says what that is.

The z-buffers of `z_buffer` have a border, so that what lands beyond the frame comes near, too. The plan has one
for each slice of the views on a CPU, and as many as fit into the cache on a GPU.

All that the alignment needs from a view at a place are six numbers for each channel, the mean and its first and second
differences, which six by six stored pixels give: nothing else is precomputed. `load` copies the views with a border, a
pixel with whether it is valid in one load, so that no tap needs to look where it is.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import Alignment, ZBuffer

from .cpu_alignment import ALIGN_ROW
from .memory import pixel_type
from .splat import as_offsets
from .threads import in_slices, lanes, launch, launch_rows, load, once, slices

wp.set_module_options({"enable_backward": False})

_NOWHERE = -1e6  # the disparity of what nothing comes near
_AT_REFERENCE = 1e-3  # view steps: what is no farther from the reference is the reference
_BUFFER = 20 * 2**20  # bytes
_BEFORE, _BORDER = 2, 5  # pixels that copies of views are longer at their left and top, and in all

_LAND = """
#ifdef __CUDA_ARCH__
    constexpr int CHUNK = 1;
#else
    constexpr int CHUNK = 128;
#endif
    const float du = offsets.data[first + n].c[0], dv = offsets.data[first + n].c[1];
    const int height = disparity.shape[0], width = disparity.shape[1];
    const int wide = width + 2 * border, high = height + 2 * border;
    float* const front = fronts.data + (size_t)n * high * wide;
    for (int begin = lane * CHUNK; begin < width; begin += lanes * CHUNK) {
        const float* const ds = disparity.data + (size_t)y * width + begin;
        const int count = CHUNK == 1 ? 1 : wp::min(CHUNK, width - begin);
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
        for (int i = 0; i < count; ++i) {
            if (places[i] < 0) continue;
            float* const place = front + places[i];
        #ifdef __CUDA_ARCH__
            // Floats of one sign are ordered as their bits are, those below 0 the other way round.
            const int bits = __float_as_int(ds[i]);
            if (bits < 0) atomicMin((unsigned*)place, (unsigned)bits);
            else atomicMax((int*)place, bits);
        #else
            if (*place < ds[i]) *place = ds[i];
        #endif
        }
    }
"""

# A CPU takes the window outside and pixels inside, many at a time.
_LOOK_AROUND = """
    const int height = nearest.shape[1], width = nearest.shape[2], side = 2 * reach + 3, wide = width + side - 1;
    const float* __restrict__ const front = fronts.data + (size_t)n * (height + side - 1) * wide + (size_t)y * wide;
    float* __restrict__ const out = nearest.data + ((size_t)n * height + y) * width;
    auto far_around = [&](int x) {
        float found = NOWHERE;
        for (int j = 0; j < side; ++j)
            for (int i = 0; i < side; ++i) found = wp::max(found, front[j * wide + x + i]);
        return found;
    };
#ifdef __CUDA_ARCH__
    for (int x = lane; x < width; x += lanes) {
        float found = NOWHERE;
        for (int j = 1; j < side - 1; ++j)
            for (int i = 1; i < side - 1; ++i) found = wp::max(found, front[j * wide + x + i]);
        out[x] = found > NOWHERE ? found : far_around(x);
    }
#else
    // Down the columns first, and then along the row.
    constexpr int ROOM = 256;
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
        if (out[x] <= NOWHERE) out[x] = far_around(x);
#endif
"""


@wp.func_native(_LAND)
def _land_row(
    disparity: wp.array2d(dtype=float),
    offsets: wp.array(dtype=wp.vec2f),
    first: int,
    border: int,
    n: int,
    y: int,
    lane: int,
    lanes: int,
    fronts: wp.array(dtype=float),
): ...


@wp.func_native(_LOOK_AROUND.replace("NOWHERE", f"{_NOWHERE}f"))
def _look_around_row(
    fronts: wp.array(dtype=float), reach: int, n: int, y: int, lane: int, lanes: int, nearest: wp.array3d(dtype=float)
): ...


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
    lanes: int,
    fronts: wp.array(dtype=float),
):
    i = wp.tid()
    row = i / lanes
    n = row / disparity.shape[0]
    _land_row(disparity, offsets, first, border, n, row - n * disparity.shape[0], i - row * lanes, lanes, fronts)


@wp.kernel
def _look_around_kernel(fronts: wp.array(dtype=float), reach: int, lanes: int, nearest_out: wp.array3d(dtype=float)):
    i = wp.tid()
    row = i / lanes
    n = row / nearest_out.shape[1]
    _look_around_row(fronts, reach, n, row - n * nearest_out.shape[1], i - row * lanes, lanes, nearest_out)


def z_buffer(shape: Sequence[int], offsets: Any, *, reach: int) -> ZBuffer:
    (count, height, width, _), device, pairs, border = shape, offsets.device, as_offsets(offsets), reach + 1
    size = (height + 2 * border) * (width + 2 * border)
    batch = 1 if device.is_cpu else min(count, max(1, _BUFFER // (4 * size)))
    room = [wp.empty(batch * size, dtype=float, device=device) for _ in slices(device, count)]

    def find(disparity: Any, nearest_out: Any) -> None:
        threads = lanes(disparity)
        load(device, _land_kernel, _clear_kernel)

        def some_views(k: int, first: int, last: int) -> None:
            for start in range(first, last, batch):
                end = min(last, start + batch)
                dim = (end - start) * height * threads
                if device.is_cpu:
                    launch(_clear_kernel, 1, [], [room[k]], device=device)
                else:
                    room[k].fill_(_NOWHERE)
                launch(_land_kernel, dim, [disparity, pairs, start, border, threads], [room[k]], device=device)
                inputs, out = [room[k], reach, threads], nearest_out[start:end]
                launch(_look_around_kernel, dim, inputs, [out], device=device)

        in_slices(device, count, some_views)

    return find


# On a GPU a thread has one pixel; `cpu_alignment.py` has the same for a row.
_ALIGN = """
    constexpr int CHUNK = 1;  // pixels of a thread
    struct Value {
        float c[CHANNELS];
        CUDA_CALLABLE float& operator[](int i) { return c[i]; }
        CUDA_CALLABLE Value operator+(const Value& o) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] + o.c[i];
            return r;
        }
        CUDA_CALLABLE Value operator-(const Value& o) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] - o.c[i];
            return r;
        }
        CUDA_CALLABLE Value operator*(const Value& o) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] * o.c[i];
            return r;
        }
        CUDA_CALLABLE Value operator*(float f) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] * f;
            return r;
        }
    };
    struct alignas(PAD * sizeof(KEPT)) Kept { KEPT c[PAD]; };
    const Kept* const recorded = (const Kept*)views.data;
    const int height = disparity.shape[0], width = disparity.shape[1], count = offsets.shape[0];
    const int wide = width + BORDER;
    const size_t size = (size_t)(height + BORDER) * wide;
    const float weaken = 1.f / (3 * CHANNELS * robust * robust);

    auto value_of = [](const Kept& kept) {
        const WORDS words = *(const WORDS*)&kept;  // one load
        const Kept loaded = *(const Kept*)&words;
        Value value;
        for (int i = 0; i < CHANNELS; ++i) value[i] = (float)loaded.c[i];
        return value;
    };
    auto sum_of = [](Value value) {
        float sum = 0.f;
        for (int i = 0; i < CHANNELS; ++i) sum += value[i];
        return sum;
    };
    auto color_at = [&](int row, int column) {
        const int p = wp::min(wp::max(row, 0), height - 1) * width + wp::min(wp::max(column, 0), width - 1);
        Value value = {};
        for (int i = 0; i < CHANNELS; ++i) value[i] = image.data[p].c[i];
        return value;
    };

    // Where a chunk of pixels lands in a view, as the first of four taps, or -1 where the view takes no part there.
    struct Places { int pixel[CHUNK], corner[CHUNK]; float ax[CHUNK], ay[CHUNK]; };
    auto land = [&](int n, int begin, int many, Places& to) {
        const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
        const float* const ds = disparity.data + (size_t)y * width + begin;
        for (int i = 0; i < many; ++i) {
            // The shift is split before the column is added: a small number keeps its digits.
            const float shift_x = -ds[i] * du, shift_y = -ds[i] * dv;
            const float whole_x = floorf(shift_x), whole_y = floorf(shift_y);
            const float column = (float)(begin + i) + whole_x, row = (float)y + whole_y;
            const float ax = shift_x - whole_x, ay = shift_y - whole_y;
            const bool inside = (column >= 0.f) & (column + (ax > 0.f ? 1.f : 0.f) <= (float)(width - 1))
                & (row >= 0.f) & (row + (ay > 0.f ? 1.f : 0.f) <= (float)(height - 1));
            to.ax[i] = ax;
            to.ay[i] = ay;
            to.pixel[i] = inside ? (int)row * width + (int)column : 0;
            to.corner[i] = inside ? ((int)row + BEFORE) * wide + (int)column + BEFORE : -1;
        }
        const float* const front = nearest.data + (size_t)n * height * width;
        const Kept* const view = recorded + n * size;
        for (int i = 0; i < many; ++i) {
            if (to.corner[i] < 0) continue;
            const int next_x = to.ax[i] >= 0.5f, next_y = to.ay[i] >= 0.5f;
            const bool seen = ds[i] >= front[to.pixel[i] + next_y * width + next_x] - tolerance;
            const bool valid = (float)view[to.corner[i] + next_y * wide + next_x].c[PAD - 1] != 0.f;
            if (!(seen & valid)) to.corner[i] = -1;
        }
    };
    auto is_reference = [&](int n) {
        const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
        return du * du + dv * dv <= NEAR * NEAR;
    };

    for (int begin = lane * CHUNK; begin < width; begin += lanes * CHUNK) {
        const int many = CHUNK == 1 ? 1 : wp::min(CHUNK, width - begin);
        Value mean[CHUNK], mean_x[CHUNK], mean_y[CHUNK], sum[CHUNK], sum_x[CHUNK], sum_y[CHUNK];
        Places to;
        float sum_k[CHUNK], curvatures[CHUNK], slopes[CHUNK];
        for (int i = 0; i < many; ++i) {
            const int x = begin + i;
            sum[i] = mean[i] = color_at(y, x);
            sum_x[i] = mean_x[i] = (color_at(y, x + 1) - color_at(y, x - 1)) * (0.5f * weight);
            sum_y[i] = mean_y[i] = (color_at(y + 1, x) - color_at(y - 1, x)) * (0.5f * weight);
            sum_k[i] = 1.f;
            curvatures[i] = slopes[i] = 0.f;
        }
        for (int n = 0; n < count; ++n) {
            if (is_reference(n)) continue;
            land(n, begin, many, to);
            for (int i = 0; i < many; ++i) {
                if (to.corner[i] < 0) continue;
                const float ax = to.ax[i], ay = to.ay[i], bx = 1.f - ax, by = 1.f - ay;
                const Kept* p = recorded + n * size + to.corner[i] - wide;
                auto mean_of = [&]() { return value_of(p[0]) * bx + value_of(p[1]) * ax; };
                auto slope_of = [&](Value m, Value r) {
                    return (value_of(p[1]) - m) * bx + (r - value_of(p[0])) * ax;
                };
                const Value m0 = mean_of();
                p += wide;
                const Value m1 = mean_of(), s1 = slope_of(value_of(p[-1]), value_of(p[2]));
                p += wide;
                const Value m2 = mean_of(), s2 = slope_of(value_of(p[-1]), value_of(p[2]));
                p += wide;
                const Value m3 = mean_of();
                const Value f = (m1 * by + m2 * ay) * scale;
                const Value fx = (s1 * by + s2 * ay) * (0.5f * scale * weight);
                const Value fy = ((m2 - m0) * by + (m3 - m1) * ay) * (0.5f * scale * weight);
                const Value r = f - mean[i], rx = fx - mean_x[i], ry = fy - mean_y[i];
                const float excess = 1.f + sum_of(r * r + rx * rx + ry * ry) * weaken, k = 1.f / (excess * excess);
                sum[i] = sum[i] + f * k;
                sum_x[i] = sum_x[i] + fx * k;
                sum_y[i] = sum_y[i] + fy * k;
                sum_k[i] += k;
            }
        }
        for (int i = 0; i < many; ++i) {
            const float share = 1.f / sum_k[i];
            mean[i] = sum[i] * share;
            mean_x[i] = sum_x[i] * share;
            mean_y[i] = sum_y[i] * share;
        }
        for (int n = 0; n < count; ++n) {
            if (is_reference(n)) continue;
            const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
            land(n, begin, many, to);
            for (int i = 0; i < many; ++i) {
                if (to.corner[i] < 0) continue;
                const float ax = to.ax[i], ay = to.ay[i], bx = 1.f - ax, by = 1.f - ay;
                // Along a row the mean m, twice its difference s, and four times the second one t; rows 0 to 5.
                const Kept* p = recorded + n * size + to.corner[i] - 2 * wide;
                auto m_of = [&]() { return value_of(p[0]) * bx + value_of(p[1]) * ax; };
                const Value m0 = m_of();
                p += wide;
                auto s_of = [&]() {
                    return (value_of(p[1]) - value_of(p[-1])) * bx + (value_of(p[2]) - value_of(p[0])) * ax;
                };
                const Value m1 = m_of(), s1 = s_of();
                p += wide;
                auto t_of = [&](Value m) {
                    return value_of(p[-2]) * bx + value_of(p[-1]) * ax + value_of(p[2]) * bx + value_of(p[3]) * ax
                        - m * 2.f;
                };
                const Value m2 = m_of(), s2 = s_of(), t2 = t_of(m2);
                p += wide;
                const Value m3 = m_of(), s3 = s_of(), t3 = t_of(m3);
                p += wide;
                const Value m4 = m_of(), s4 = s_of();
                p += wide;
                const Value m5 = m_of();
                const Value f = (m2 * by + m3 * ay) * scale;
                const Value fx = (s2 * by + s3 * ay) * (0.5f * scale);
                const Value fy = ((m3 - m1) * by + (m4 - m2) * ay) * (0.5f * scale);
                const Value fxx = (t2 * by + t3 * ay) * (0.25f * scale);
                const Value fxy = ((s3 - s1) * by + (s4 - s2) * ay) * (0.25f * scale);
                const Value fyy = ((m0 + m4 - m2 * 2.f) * by + (m1 + m5 - m3 * 2.f) * ay) * (0.25f * scale);
                const Value r = f - mean[i], rx = fx * weight - mean_x[i], ry = fy * weight - mean_y[i];
                const float excess = 1.f + sum_of(r * r + rx * rx + ry * ry) * weaken, k = 1.f / (excess * excess);
                // Against the derivatives by d, so that their product with the residuals is what the slope adds up.
                const Value g = fx * du + fy * dv;
                const Value gx = (fxx * du + fxy * dv) * weight, gy = (fxy * du + fyy * dv) * weight;
                curvatures[i] += k * sum_of(g * g + gx * gx + gy * gy);
                slopes[i] += k * sum_of(g * r + gx * rx + gy * ry);
            }
        }
        for (int i = 0; i < many; ++i) {
            curvature.data[(size_t)y * width + begin + i] = curvatures[i] * share_of_all;
            slope.data[(size_t)y * width + begin + i] = slopes[i] * share_of_all;
        }
    }
"""


@once
def _kernels(channels: int, stored: Any, compact: Any, on_cpu: bool) -> SimpleNamespace:
    """Views come as `stored` and are kept as `compact` scalars."""
    pad = 4 if channels == 3 else 2
    pixel, stored_pixel, kept_pixel = (
        pixel_type(channels),
        pixel_type(channels, stored),
        pixel_type(pad, compact),
    )
    module = f"lfgpu_{'cpu' if on_cpu else 'gpu'}_alignment_{channels}_{stored.__name__}_{compact.__name__}"
    kept_name, bytes_ = {
        wp.uint8: ("unsigned char", 1),
        wp.uint16: ("unsigned short", 2),
        wp.float16: ("wp::half", 2),
        wp.float32: ("float", 4),
    }[compact]
    words = {2: "unsigned short", 4: "unsigned", 8: "uint2", 16: "uint4"}[pad * bytes_]

    # A CPU reads a pixel as one integer, and of floats each channel by itself.
    integers = {2: "unsigned short", 4: "unsigned", 8: "unsigned long long"}
    word = integers[pad * bytes_] if compact in (wp.uint8, wp.uint16) else f"struct {{ {kept_name} c[{pad}]; }}"
    code = ALIGN_ROW if on_cpu else _ALIGN
    for name, value in (
        ("CHANNELS", channels),
        ("PAD", pad),
        ("KEPT", kept_name),
        ("WORDS", words),
        ("WORD", word),
        ("BITS", 8 * bytes_),
        ("IS_FLOAT", int(compact is wp.float32)),
        ("BORDER", _BORDER),
        ("BEFORE", _BEFORE),
        ("NEAR", f"{_AT_REFERENCE}f"),
    ):
        code = code.replace(name, str(value))

    @wp.func_native(code)
    def align_row(
        image: wp.array2d(dtype=pixel),
        views: wp.array3d(dtype=kept_pixel),
        offsets: wp.array(dtype=wp.vec2f),
        scale: float,
        weight: float,
        robust: float,
        tolerance: float,
        share_of_all: float,
        disparity: wp.array2d(dtype=float),
        nearest: wp.array3d(dtype=float),
        y: int,
        lane: int,
        lanes: int,
        curvature: wp.array2d(dtype=float),
        slope: wp.array2d(dtype=float),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def pack_kernel(
        recorded: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        row: int,
        lanes: int,
        packed_out: wp.array3d(dtype=kept_pixel),
    ):
        """Copies views continued by their border pixels; what is there last is whether the pixel is valid."""
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        from_y = wp.clamp(y - wp.static(_BEFORE), 0, recorded.shape[1] - 1)
        for n in range(recorded.shape[0]):
            for x in range(lane, packed_out.shape[2], lanes):
                from_x = wp.clamp(x - wp.static(_BEFORE), 0, recorded.shape[2] - 1)
                value = recorded[n, from_y, from_x]
                packed = kept_pixel()
                for c in range(wp.static(channels)):
                    packed[c] = compact(value[c])
                if not valid or valid[n, from_y, from_x] != 0.0:
                    packed[wp.static(pad - 1)] = compact(1.0)
                packed_out[n, y, x] = packed

    @wp.kernel(module=module, enable_backward=False)
    def align_kernel(
        image: wp.array2d(dtype=pixel),
        views: wp.array3d(dtype=kept_pixel),
        offsets: wp.array(dtype=wp.vec2f),
        scale: float,
        weight: float,
        robust: float,
        tolerance: float,
        share_of_all: float,
        disparity: wp.array2d(dtype=float),
        nearest: wp.array3d(dtype=float),
        row: int,
        lanes: int,
        curvature_out: wp.array2d(dtype=float),
        slope_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        line = i / lanes
        align_row(
            image,
            views,
            offsets,
            scale,
            weight,
            robust,
            tolerance,
            share_of_all,
            disparity,
            nearest,
            row + line,
            i - line * lanes,
            lanes,
            curvature_out,
            slope_out,
        )

    return SimpleNamespace(pack=pack_kernel, align=align_kernel)


class _Alignment:
    def __init__(
        self,
        shape: Sequence[int],
        offsets: Any,
        scale: float,
        gradient_weight: float,
        robust: float,
        tolerance: float,
    ) -> None:
        self._shape, self._pairs = tuple(shape), as_offsets(offsets)
        others = int((np.hypot(*offsets.numpy().T) > _AT_REFERENCE).sum())
        share_of_all = 1 / (3 * shape[3] * max(others, 1))
        self._compared = [scale, gradient_weight, robust, tolerance, share_of_all]
        self._stored: Any = None

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        stored, device = recorded.dtype._wp_scalar_type_, image.device
        if stored is not self._stored:
            n, height, width, channels = self._shape
            # A CPU reads half precision slowly, and each pixel many times.
            compact = wp.float32 if stored is wp.float16 and device.is_cpu else stored
            size, kept = (n, height + _BORDER, width + _BORDER), pixel_type(4 if channels == 3 else 2, compact)
            self._stored, self._kernels = stored, _kernels(channels, stored, compact, device.is_cpu)
            self._packed = wp.empty(size, dtype=kept, device=device)
        self._image = image
        launch_rows(self._kernels.pack, [recorded, valid], self._packed)

    def __call__(self, disparity: Any, nearest: Any, curvature_out: Any, slope_out: Any) -> None:
        inputs = [self._image, self._packed, self._pairs, *self._compared, disparity, nearest]
        launch_rows(self._kernels.align, inputs, curvature_out, slope_out)


def alignment(
    shape: Sequence[int],
    offsets: Any,
    *,
    scale: float,
    gradient_weight: float,
    robust: float,
    tolerance: float,
) -> Alignment:
    return _Alignment(shape, offsets, scale, gradient_weight, robust, tolerance)
