"""The data term on a GPU: prediction, residual, value and gradient in two kernels for some views at a time.

A buffer begins as minus the recorded views, to which the splat adds: what is then in it is the residual. The gradient
gathers from it, adds up its squares, and sets up the other buffer for the next views. Both buffers together fit into
the cache of the GPU. A pixel in them is its channels and, last, whether it counts: one load, or one atomic addition.
Views that come in half precision are kept so: the kernels wait for memory.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import warp as wp

from .memory import pixel_type
from .threads import once
from .vector import sum_kernel

wp.set_module_options({"enable_backward": False})

_STRIP = 8  # rows that a thread splats one after the other, so that what it adds to a pixel twice it adds once
_BUFFER = 20 * 2**20  # bytes
_WARP = 32
_BLOCK = 128
_SUM_BLOCK = 1024

_COMMON = """
    struct alignas(PAD * sizeof(float)) Pixel { float c[PAD]; };  // aligned, and so one load or store
    struct alignas(PAD * sizeof(KEPT)) Kept { KEPT c[PAD]; };
    typedef WORDS Words;  // of the same size
    const Pixel* const colors = (const Pixel*)image.data;
    const int height = disparity.shape[0], width = disparity.shape[1];
    const float k = 0.5f / softness, s = 1.f / (1.f - softness);
    auto tent = [&](float a) {
        const float top = fminf(a, softness), foot = fmaxf(a - (1.f - softness), 0.f);
        return 1.f - (a - top + (top * top - foot * foot) * k) * s;
    };
"""

_SPLAT_STRIP = (
    _COMMON
    + """
    // What goes to the right is handed to the next lane where that one adds to the same pixel, and what goes below is
    // kept for the row below: most pixels get one addition for each pixel that lands on them instead of four.
    const int lane = x & 31;
    const bool inside = x < width;
    float* const view = (float*)(residual.data + (size_t)n * height * width);
    auto add = [&](int tx, int ty, const float* value) {
        if ((unsigned)tx >= (unsigned)width || (unsigned)ty >= (unsigned)height) return;
        float* const p = view + (ty * width + tx) * PAD;
    #if __CUDA_ARCH__ >= 900 && CHANNELS == 3
        asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
                     :: "l"(p), "f"(value[0]), "f"(value[1]), "f"(value[2]), "f"(0.f) : "memory");
    #elif __CUDA_ARCH__ >= 900
        asm volatile("red.global.add.v2.f32 [%0], {%1, %2};" :: "l"(p), "f"(value[0]), "f"(0.f) : "memory");
    #else
        for (int c = 0; c < CHANNELS; ++c) atomicAdd(p + c, value[c]);
    #endif
    };
    int kept_x = -(1 << 20), kept_y = 0;
    float kept[CHANNELS] = {};
    for (int y = first_row; y < first_row + STRIP && y < height; ++y) {
        const float d = inside ? disparity.data[y * width + x] : 0.f;
        const float shift_x = -d * du, shift_y = -d * dv, whole_x = floorf(shift_x), whole_y = floorf(shift_y);
        const float wx = tent(shift_x - whole_x), wy = tent(shift_y - whole_y);
        const int tx = inside ? x + (int)whole_x : -(1 << 20), ty = y + (int)whole_y;
        const Pixel color = inside ? colors[y * width + x] : Pixel{};
        float left[CHANNELS], right[CHANNELS];
        for (int c = 0; c < CHANNELS; ++c) {
            const float value = color.c[c];
            left[c] = value * wx;
            right[c] = value - left[c];
        }
        const int before_x = __shfl_up_sync(~0u, tx, 1), before_y = __shfl_up_sync(~0u, ty, 1);
        const float before_wy = __shfl_up_sync(~0u, wy, 1);
        const bool takes = lane > 0 && inside && before_x + 1 == tx && before_y == ty;
        const unsigned takers = __ballot_sync(~0u, takes);  // all lanes together, whatever becomes of the answer
        const bool taken = (takers >> 1 >> lane) & 1;
        float upper[CHANNELS], lower[CHANNELS], give[CHANNELS];
        for (int c = 0; c < CHANNELS; ++c) {
            const float handed = __shfl_up_sync(~0u, right[c], 1);
            upper[c] = left[c] * wy;
            lower[c] = left[c] - upper[c];
            if (takes) {
                const float part = handed * before_wy;
                upper[c] += part;
                lower[c] += handed - part;
            }
        }
        if (!inside) continue;
        if (!taken) {
            for (int c = 0; c < CHANNELS; ++c) give[c] = right[c] * wy;
            add(tx + 1, ty, give);
            for (int c = 0; c < CHANNELS; ++c) give[c] = right[c] - give[c];
            add(tx + 1, ty + 1, give);
        }
        if (kept_x == tx && kept_y == ty)
            for (int c = 0; c < CHANNELS; ++c) upper[c] += kept[c];
        else
            add(kept_x, kept_y, kept);
        add(tx, ty, upper);
        kept_x = tx;
        kept_y = ty + 1;
        for (int c = 0; c < CHANNELS; ++c) kept[c] = lower[c];
    }
    if (inside) add(kept_x, kept_y, kept);
"""
)

_GATHER = (
    _COMMON
    + """
    const int p = y * width + x, size = height * width;
    float total = 0.f, square = 0.f;
    if (x < width) {
        const float d = disparity.data[p];
        const Pixel value = colors[p];
        for (int n = 0; n < count; ++n) {
            const float du = offsets.data[first + n].c[0], dv = offsets.data[first + n].c[1];
            const float shift_x = -d * du, shift_y = -d * dv, whole_x = floorf(shift_x), whole_y = floorf(shift_y);
            const float ax = shift_x - whole_x, ay = shift_y - whole_y, wx = tent(ax), wy = tent(ay);
            const float sx = du * s * fminf(fminf(ax, 1.f - ax) * (1.f / softness), 1.f);
            const float sy = dv * s * fminf(fminf(ay, 1.f - ay) * (1.f / softness), 1.f);
            const int tx = x + (int)whole_x, ty = y + (int)whole_y;
            const Pixel* const view = (const Pixel*)residual.data + (size_t)n * size;
            const Pixel* const corner = view + ty * width + tx;
            const bool x0 = (unsigned)tx < (unsigned)width, x1 = (unsigned)(tx + 1) < (unsigned)width;
            const bool y0 = (unsigned)ty < (unsigned)height, y1 = (unsigned)(ty + 1) < (unsigned)height;
            const Pixel here = view[p];
            const Pixel r00 = x0 && y0 ? corner[0] : Pixel{}, r01 = x1 && y0 ? corner[1] : Pixel{};
            const Pixel r10 = x0 && y1 ? corner[width] : Pixel{}, r11 = x1 && y1 ? corner[width + 1] : Pixel{};
            float a00 = 0.f, a01 = 0.f, a10 = 0.f, a11 = 0.f, sum = 0.f;
            for (int c = 0; c < CHANNELS; ++c) {
                a00 += value.c[c] * r00.c[c];
                a01 += value.c[c] * r01.c[c];
                a10 += value.c[c] * r10.c[c];
                a11 += value.c[c] * r11.c[c];
                sum += here.c[c] * here.c[c];
            }
            a00 *= r00.c[PAD - 1];
            a01 *= r01.c[PAD - 1];
            a10 *= r10.c[PAD - 1];
            a11 *= r11.c[PAD - 1];
            total += sx * (wy * (a00 - a01) + (1.f - wy) * (a10 - a11));
            total += sy * (wx * (a00 - a10) + (1.f - wx) * (a01 - a11));
            square += here.c[PAD - 1] * sum;
        }
        for (int n = 0; n < next_count; ++n) {
            // Read once: it shall not drive what is read again out of the cache.
            const Words words = __ldcs((const Words*)recorded.data + (size_t)(next_first + n) * size + p);
            const Kept packed = *(const Kept*)&words;
            Pixel begin;
            for (int c = 0; c < CHANNELS; ++c) begin.c[c] = -scale * (float)packed.c[c];
            begin.c[PAD - 1] = (float)packed.c[PAD - 1];
            ((Pixel*)following.data)[(size_t)n * size + p] = begin;
        }
    }
    if (x < width) gradient.data[p] = first > 0 ? gradient.data[p] + 2.f * total : 2.f * total;
    double sum = square;
    for (int step = 16; step; step >>= 1) sum += __shfl_xor_sync(~0u, sum, step);
    if ((x & 31) == 0) {
        double* const place = squares.data + (size_t)y * squares.shape[1] + (x >> 5);
        *place = first > 0 ? *place + sum : sum;
    }
"""
)


@once
def _kernels(channels: int, stored: Any, compact: Any) -> SimpleNamespace:
    """Views come as `stored` and are kept as `compact` scalars."""
    pad = 4 if channels == 3 else 2
    pixel, stored_pixel = pixel_type(channels), pixel_type(channels, stored)
    padded, kept_pixel = pixel_type(pad), pixel_type(pad, compact)
    module = f"lfgpu_gpu_data_term_{channels}_{stored.__name__}"

    kept_name, bytes_ = ("wp::half", 2 * pad) if compact is wp.float16 else ("float", 4 * pad)
    words = {4: "unsigned", 8: "uint2", 16: "uint4"}[bytes_]

    def code(text: str) -> str:
        for name, value in (
            ("CHANNELS", channels),
            ("PAD", pad),
            ("STRIP", _STRIP),
            ("KEPT", kept_name),
            ("WORDS", words),
        ):
            text = text.replace(name, str(value))
        return text

    @wp.func_native(code(_SPLAT_STRIP))
    def splat_strip(
        image: wp.array2d(dtype=padded),
        disparity: wp.array2d(dtype=float),
        du: float,
        dv: float,
        softness: float,
        n: int,
        first_row: int,
        x: int,
        residual: wp.array3d(dtype=padded),
    ): ...

    @wp.func_native(code(_GATHER))
    def gather(
        image: wp.array2d(dtype=padded),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        softness: float,
        first: int,
        count: int,
        residual: wp.array3d(dtype=padded),
        recorded: wp.array3d(dtype=kept_pixel),
        next_first: int,
        next_count: int,
        scale: float,
        following: wp.array3d(dtype=padded),
        y: int,
        x: int,
        gradient: wp.array2d(dtype=float),
        squares: wp.array2d(dtype=wp.float64),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def pad_kernel(image: wp.array2d(dtype=pixel), padded_out: wp.array2d(dtype=padded)):
        y, x = wp.tid()
        value = padded()
        for c in range(wp.static(channels)):
            value[c] = image[y, x][c]
        padded_out[y, x] = value

    @wp.kernel(module=module, enable_backward=False)
    def pack_kernel(
        recorded: wp.array3d(dtype=stored_pixel),
        valid: wp.array3d(dtype=float),
        packed_out: wp.array3d(dtype=kept_pixel),
    ):
        i = wp.tid()
        size = recorded.shape[1] * recorded.shape[2]
        n = i / size
        y = (i - n * size) / recorded.shape[2]
        x = i % recorded.shape[2]
        packed = kept_pixel()
        if not valid or valid[n, y, x] != 0.0:
            value = recorded[n, y, x]
            for c in range(wp.static(channels)):
                packed[c] = compact(value[c])
            packed[wp.static(pad - 1)] = compact(1.0)
        packed_out[n, y, x] = packed

    @wp.kernel(module=module, enable_backward=False)
    def set_up_kernel(
        recorded: wp.array3d(dtype=kept_pixel), first: int, scale: float, residual_out: wp.array3d(dtype=padded)
    ):
        n, y, x = wp.tid()
        packed = recorded[first + n, y, x]
        value = padded()
        for c in range(wp.static(channels)):
            value[c] = -scale * float(packed[c])
        value[wp.static(pad - 1)] = float(packed[wp.static(pad - 1)])
        residual_out[n, y, x] = value

    @wp.kernel(module=module, enable_backward=False)
    def splat_kernel(
        image: wp.array2d(dtype=padded),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        softness: float,
        first: int,
        lanes: int,
        residual: wp.array3d(dtype=padded),
    ):
        i = wp.tid()
        strip = i / lanes
        x = i - strip * lanes
        strips = (disparity.shape[0] + wp.static(_STRIP - 1)) / wp.static(_STRIP)
        n = strip / strips
        strip = strip - n * strips
        offset = offsets[first + n]
        splat_strip(image, disparity, offset[0], offset[1], softness, n, strip * wp.static(_STRIP), x, residual)

    @wp.kernel(module=module, enable_backward=False)
    def gather_kernel(
        image: wp.array2d(dtype=padded),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        softness: float,
        first: int,
        count: int,
        residual: wp.array3d(dtype=padded),
        recorded: wp.array3d(dtype=kept_pixel),
        next_first: int,
        next_count: int,
        scale: float,
        lanes: int,
        next_out: wp.array3d(dtype=padded),
        gradient_out: wp.array2d(dtype=float),
        squares_out: wp.array2d(dtype=wp.float64),
    ):
        i = wp.tid()
        y = i / lanes
        gather(
            image,
            disparity,
            offsets,
            softness,
            first,
            count,
            residual,
            recorded,
            next_first,
            next_count,
            scale,
            next_out,
            y,
            i - y * lanes,
            gradient_out,
            squares_out,
        )

    return SimpleNamespace(
        pad=pad_kernel, pack=pack_kernel, set_up=set_up_kernel, splat=splat_kernel, gather=gather_kernel
    )


class GpuDataTerm:
    """The plan of the data term on a GPU."""

    def __init__(self, shape: Sequence[int], offsets: Any, scale: float, softness: float) -> None:
        _, height, width, channels = shape
        self._shape, self._offsets, self._scale, self._softness = tuple(shape), offsets.view(wp.vec2f), scale, softness
        self._image = wp.empty((height, width), dtype=pixel_type(4 if channels == 3 else 2), device=offsets.device)
        self._lanes = -(-width // _WARP) * _WARP
        self._squares = wp.zeros((height, self._lanes // _WARP), dtype=wp.float64, device=offsets.device)
        self._stored: Any = None

    def _prepare(self, stored: Any) -> None:
        """Allocate for views of scalar type `stored`."""
        n, height, width, channels = self._shape
        device, pad = self._image.device, self._image.dtype._length_
        compact = wp.float16 if stored is wp.float16 else wp.float32
        self._stored, self._kernels = stored, _kernels(channels, stored, compact)
        self._packed = wp.empty((n, height, width), dtype=pixel_type(pad, compact), device=device)
        # An even number of batches: the last one of an evaluation sets up the buffer of the next one's first.
        most = max(1, _BUFFER // (height * width * pad * 4))
        count = 2 * -(-n // (2 * most))
        size = -(-n // count)
        self._batches = [(first, max(0, min(size, n - first))) for first in range(0, count * size, size)]
        self._buffers = [wp.empty((size, height, width), dtype=pixel_type(pad), device=device) for _ in range(2)]

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        n, height, width, _ = self._shape
        stored, device = recorded.dtype._wp_scalar_type_, image.device
        if stored is not self._stored:
            self._prepare(stored)
        wp.launch(self._kernels.pad, (height, width), [image], [self._image], device=device)
        wp.launch(self._kernels.pack, n * height * width, [recorded, valid], [self._packed], device=device)
        first, count = self._batches[0]
        inputs = [self._packed, first, self._scale]
        wp.launch(self._kernels.set_up, (count, height, width), inputs, [self._buffers[0]], device=device)

    def __call__(self, disparity: Any, gradient_out: Any, value_out: Any) -> None:
        _, height, _, _ = self._shape
        batches, device, seen = self._batches, disparity.device, [self._image, disparity, self._offsets, self._softness]
        for k, (first, count) in enumerate(batches):
            residual, following = self._buffers[k % 2], self._buffers[(k + 1) % 2]
            if count:
                dim, inputs = count * -(-height // _STRIP) * self._lanes, [*seen, first, self._lanes]
                wp.launch(self._kernels.splat, dim, inputs, [residual], device=device, block_dim=_BLOCK)
            inputs = [*seen, first, count, residual, self._packed, *batches[(k + 1) % len(batches)]]
            inputs += [self._scale, self._lanes]
            outputs = [following, gradient_out, self._squares]
            dim = height * self._lanes
            wp.launch(self._kernels.gather, dim, inputs, outputs, device=device, block_dim=_BLOCK)
        parts = self._squares.flatten()
        wp.launch_tiled(sum_kernel, dim=[1], inputs=[parts], outputs=[value_out], block_dim=_SUM_BLOCK, device=device)
