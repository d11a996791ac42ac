"""The plane sweep on a GPU: each warp has a strip of a few rows and 32 columns at one disparity, and all views of it.

A thread goes down its column: what it interpolated between two columns of a row of the view serves the pixels above and
below, and its differences serve their gradients. Those in x come from the threads beside it, so that the outer two
columns of a warp are there for their neighbours only. Kept pixels are their channels and, last, whether they are valid.
"""

from typing import Any

import warp as wp

from .memory import pixel_type
from .threads import once

wp.set_module_options({"enable_backward": False})

BLOCK = 128
_STRIPS = {False: 7, True: 2}  # rows, of a sweep by view_sets and of one of the views that see a pixel: as measured
_WARP = 32
_COLUMNS = _WARP - 2
_NAMES = {
    wp.uint8: "unsigned char",
    wp.uint16: "unsigned short",
    wp.float16: "wp::half",
    wp.float32: "float",
}

_SWEEP_STRIP = """
    #if BYTES
        struct Kept { WORD bytes; };
        auto value_of = [](Kept pixel, int c) {
            // A byte in the lowest place of the float 2^23 adds its value to it: cheaper for a GPU than a conversion.
            return __uint_as_float(__byte_perm(pixel.bytes, 0x4b000000u, 0x7440u | c));
        };
        auto is_counted = [](Kept pixel) { return pixel.bytes >> 8 * (PAD - 1) != 0; };
        const float zero = 8388608.f;
    #else
        struct alignas(PAD * sizeof(KEPT)) Kept { KEPT c[PAD]; };  // aligned, and so one load
        auto value_of = [](const Kept& pixel, int c) { return (float)pixel.c[c]; };
        auto is_counted = [](const Kept& pixel) { return (float)pixel.c[PAD - 1] != 0.f; };
        const float zero = 0.f;
    #endif
    const int height = image.shape[0], width = image.shape[1], count = order.shape[0];
    const int columns = (width + COLUMNS - 1) / COLUMNS, strips = (height + STRIP - 1) / STRIP;
    const int lane = thread & 31, warp = thread >> 5;
    const int l = warp / (strips * columns), place = warp - l * (strips * columns), strip = place / columns;
    const int x = (place - strip * columns) * COLUMNS + lane - 1, y = strip * STRIP;
    auto within = [](int i, int size) { return min(max(i, 0), size - 1); };
    const int column = within(x, width);
    const size_t plane = (size_t)height * width;

    float color[STRIP + 2][CHANNELS];
    #pragma unroll
    for (int r = 0; r < STRIP + 2; ++r)
        for (int c = 0; c < CHANNELS; ++c)
            color[r][c] = image.data[within(y + r - 1, height) * width + column].c[c];
    // Of a sweep of what is seen, the sums are those past each surface; of one by view sets, those of each set.
    float cost[STRIP] = {}, number[STRIP] = {}, sums[SETS][STRIP] = {}, counts[SETS][STRIP] = {};
    const float deepest = limits.data[l];

    for (int k = 0; k < count; ++k) {
        const float4 shift = ((const float4*)shifts.data)[l * count + k];
        const int dx = (int)shift.x, dy = (int)shift.y, n = order.data[k];
        const bool right = shift.z >= 0.5f, down = shift.w >= 0.5f;
        const int x0 = within(column + dx, width), x1 = within(column + dx + 1, width);
        // Of what lies between two pixels, both are in the frame.
        const bool inside = (unsigned)(x + dx) < (unsigned)(width - (shift.z > 0.f));
        const unsigned rows_inside = height - (shift.w > 0.f);
        const Kept* const view = (const Kept*)views.data + n * plane;

        float upper[CHANNELS], before[CHANNELS] = {}, here[CHANNELS] = {};
        bool upper_valid, part = false;
        auto interpolate = [&](int row, float* level, bool& is_valid) {
            const int line = within(row, height) * width;
            const Kept a = view[line + x0], b = view[line + x1];
            is_valid = right ? is_counted(b) : is_counted(a);
            for (int c = 0; c < CHANNELS; ++c) {
                const float value = value_of(a, c);
                level[c] = value - zero + shift.z * (value_of(b, c) - value);
            }
        };
        interpolate(y - 1 + dy, upper, upper_valid);
        #pragma unroll
        for (int r = 0; r < STRIP + 2; ++r) {  // row y + r - 1 becomes the one after; the one before it is summed up
            float lower[CHANNELS], after[CHANNELS];
            bool lower_valid;
            interpolate(y + r + dy, lower, lower_valid);
            const bool next_part = down ? lower_valid : upper_valid;
            for (int c = 0; c < CHANNELS; ++c) {
                after[c] = scale * (upper[c] + shift.w * (lower[c] - upper[c])) - color[r][c];
                upper[c] = lower[c];
            }
            upper_valid = lower_valid;
            if (r >= 2) {
                const int row = y + r - 2;
                const bool first = r == 2 && row == 0, last = row == height - 1;
                bool takes = part && inside && (unsigned)(row + dy) < rows_inside;
                float front = 0.f, sure = 0.f;  // asked for before there is something else to do
                if (SEEN && takes) {
                    const size_t there = n * plane + (row + dy + down) * width + x + dx + right;
                    front = nearest.data[there];
                    if (SETS > 1) sure = certain.data[there];
                }
                float size = 0.f, slope = 0.f, along = 0.f;
                for (int c = 0; c < CHANNELS; ++c) {
                    along += fabsf(__shfl_down_sync(~0u, here[c], 2) - here[c]);  // of the column to the right
                    size += fabsf(here[c]);
                    slope += fabsf((last ? here[c] : after[c]) - (first ? here[c] : before[c]));
                }
                slope += __shfl_up_sync(~0u, along, 1);
                const float robust = fminf(size * (1.f / CHANNELS), truncation)
                    + gradient_weight * fminf(slope * (0.25f / CHANNELS), gradient_truncation);
                if (SEEN) {
                    if (takes && front <= deepest) {
                        sums[0][r - 2] += robust;
                        counts[0][r - 2] += 1.f;
                    }
                    if (SETS > 1 && takes && sure <= deepest) {
                        sums[SETS - 1][r - 2] += robust;
                        counts[SETS - 1][r - 2] += 1.f;
                    }
                } else if (takes) {
                    cost[r - 2] += robust;
                    number[r - 2] += 1.f;
                }
            }
            for (int c = 0; c < CHANNELS; ++c) {
                before[c] = here[c];
                here[c] = after[c];
            }
            part = next_part;
        }

        if (!SEEN && (k + 1 == count || members.data[k + 1] != members.data[k])) {
            const unsigned bits = members.data[k];
            #pragma unroll
            for (int m = 0; m < SETS; ++m)
                if (bits >> m & 1u)
                    for (int r = 0; r < STRIP; ++r) {
                        sums[m][r] += cost[r];
                        counts[m][r] += number[r];
                    }
            for (int r = 0; r < STRIP; ++r) cost[r] = number[r] = 0.f;
        }
    }

    if (lane == 0 || lane == 31 || x >= width) return;
    const float fade = 1.f / (1.f + gradient_weight);
    const float most = fade * (truncation + gradient_weight * gradient_truncation);
    #pragma unroll
    for (int r = 0; r < STRIP; ++r) {
        if (y + r >= height) break;
        float lowest = counts[0][r] >= least ? fade * sums[0][r] / counts[0][r] : most;
        #pragma unroll
        for (int m = 1; m < SETS; ++m)
            if (SEEN && counts[m][r] >= least)
                lowest = fminf(lowest, fade * sums[m][r] / counts[m][r] + penalty);
            else if (!SEEN && counts[m][r] > 0.f)
                lowest = fminf(lowest, (1.f + preference) * (fade * sums[m][r] / counts[m][r]) + PENALTY);
        volume.data[l * plane + (size_t)(y + r) * width + x] = lowest;
    }
"""


def threads_of(labels: int, height: int, width: int, *, seen: bool) -> int:
    """How many threads a sweep is launched with."""
    return labels * -(-height // _STRIPS[seen]) * -(-width // _COLUMNS) * _WARP


def kept_type(channels: int, stored: Any) -> Any:
    """What a pixel of the views is kept as."""
    return pixel_type(4 if channels == 3 else 2, stored)


@once
def pack_kernel(channels: int, stored: Any) -> Any:
    stored_pixel, kept_pixel = pixel_type(channels, stored), kept_type(channels, stored)

    @wp.kernel(module=f"lfgpu_gpu_plane_sweep_pack_{channels}_{stored.__name__}", enable_backward=False)
    def pack(
        views: wp.array3d(dtype=stored_pixel), valid: wp.array3d(dtype=float), kept_out: wp.array3d(dtype=kept_pixel)
    ):
        i = wp.tid()
        size = views.shape[1] * views.shape[2]
        n = i / size
        y = (i - n * size) / views.shape[2]
        x = i % views.shape[2]
        value = views[n, y, x]
        kept = kept_pixel()
        for c in range(wp.static(channels)):
            kept[c] = value[c]
        if not valid or valid[n, y, x] != 0.0:
            kept[wp.static(kept_pixel._length_ - 1)] = stored(1)
        kept_out[n, y, x] = kept

    return pack


@once
def sweep_kernel(channels: int, stored: Any, sums: int, seen: bool, set_penalty: float) -> Any:
    """The kernel for so many sums: of view sets or, if `seen`, of views that see a pixel past each surface, 1 or 2."""
    pixel, kept_pixel = pixel_type(channels), kept_type(channels, stored)
    code = _SWEEP_STRIP
    for name, value in (
        ("CHANNELS", channels),
        ("SETS", sums),
        ("COLUMNS", _COLUMNS),
        ("STRIP", _STRIPS[seen]),
        ("PENALTY", f"{set_penalty}f"),
        ("SEEN", str(seen).lower()),
        ("BYTES", int(stored is wp.uint8)),
        ("WORD", "unsigned" if channels == 3 else "unsigned short"),
        ("KEPT", _NAMES[stored]),
        ("PAD", kept_pixel._length_),
    ):
        code = code.replace(name, str(value))

    @wp.func_native(code)
    def sweep_strip(
        views: wp.array3d(dtype=kept_pixel),
        image: wp.array2d(dtype=pixel),
        nearest: wp.array3d(dtype=float),
        certain: wp.array3d(dtype=float),
        order: wp.array(dtype=int),
        members: wp.array(dtype=int),
        shifts: wp.array2d(dtype=wp.vec4f),
        limits: wp.array(dtype=float),
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        preference: float,
        least: float,
        penalty: float,
        thread: int,
        volume: wp.array3d(dtype=float),
    ): ...

    module = f"lfgpu_gpu_plane_sweep_{channels}_{stored.__name__}_{sums}_{seen:d}"

    @wp.kernel(module=module, enable_backward=False)
    def sweep(
        views: wp.array3d(dtype=kept_pixel),
        image: wp.array2d(dtype=pixel),
        nearest: wp.array3d(dtype=float),
        certain: wp.array3d(dtype=float),
        order: wp.array(dtype=int),
        members: wp.array(dtype=int),
        shifts: wp.array2d(dtype=wp.vec4f),
        limits: wp.array(dtype=float),
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        preference: float,
        least: float,
        penalty: float,
        volume_out: wp.array3d(dtype=float),
    ):
        sweep_strip(
            views,
            image,
            nearest,
            certain,
            order,
            members,
            shifts,
            limits,
            scale,
            truncation,
            gradient_weight,
            gradient_truncation,
            preference,
            least,
            penalty,
            wp.tid(),
            volume_out,
        )

    return sweep
