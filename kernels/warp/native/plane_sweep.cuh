// The plane sweep on a GPU: each warp has a strip of a few rows and 32 columns at one disparity, and all views of it.
//
// The warps of a block have the same strip at neighbouring disparities: what they read of a view is nearly the same.
//
// A thread goes down its column: what it interpolated between two columns of a row of the view serves the pixels above
// and below, and its differences serve their gradients. Those in x come from the threads beside it, so that the outer
// two columns of a warp are there for their neighbours only, as are the rows above and below a strip. Without gradients
// there is no such rim. Kept pixels are their channels and, last, whether they are valid. For a sweep of the views that
// see a pixel, each pixel of a view has a mark: the first disparity that is seen there past a surface.
#pragma once
#include "lfgpu.h"

// Keep a pixel of a view with whether it is valid.
void pack(int tid, Array1<Stored> views, Array1<float> valid, Array1<Kept> kept_out) {
    const auto value = views.data[tid];
    auto to = kept_out.data[0];
    for (int c = 0; c < PAD; ++c) to.c[c] = 0;
    for (int c = 0; c < CHANNELS; ++c) to.c[c] = value.c[c];
    if (!valid.data || valid.data[tid] != 0.f) to.c[PAD - 1] = 1;
    kept_out.data[tid] = to;
}

// Mark a pixel of a view in `order` with the first disparity past the surface; what does not count has a mark past all.
void mark(
    int tid, Array1<Kept> views, Array1<float> nearest, Array1<int> order, int plane, Array1<float> limits,
    Array1<uint16> marks_out) {
    const size_t at = (size_t)order.data[tid / plane] * plane + tid % plane;
    // The limits are as far apart, but for rounding.
    const int count = limits.shape[0];
    const float lowest = limits.data[0], per_unit = count > 1 ? (count - 1) / (limits.data[count - 1] - lowest) : 0.f;
    auto first_past = [&](float surface) {
        int k = (int)min(max((surface - lowest) * per_unit, 0.f), (float)count);
        while (k > 0 && surface <= limits.data[k - 1]) --k;
        while (k < count && surface > limits.data[k]) ++k;
        return k;
    };
    marks_out.data[at] = (float)views.data[at].c[PAD - 1] != 0.f ? first_past(nearest.data[at]) : 0xffff;
}

// Sweep a strip.
void sweep_strip(
    int tid, Array3<Kept> views, Array2<Pixel> image, Array3<uint16> marks, Array1<int> order, Array1<int> members,
    Array2<vec4f> shifts, float scale, float truncation, float gradient_weight, float gradient_truncation,
    Number softness, float preference, float least, Array3<float> volume_out) {
    const int height = image.shape[0], width = image.shape[1], count = order.shape[0];
    const int columns = (width + COLUMNS - 1) / COLUMNS, strips = (height + STRIP - 1) / STRIP;
    const int thread = tid, lane = thread & 31, block = thread / BLOCK;
    const int part_of = block / (strips * columns), place = block - part_of * (strips * columns);
    const int l = min(part_of * (BLOCK / 32) + thread % BLOCK / 32, volume_out.shape[0] - 1), strip = place / columns;
    const int x = (place - strip * columns) * COLUMNS + lane - RIM, y = strip * STRIP;
    auto within = [](int i, int size) { return min(max(i, 0), size - 1); };
    const int column = within(x, width);
    const size_t plane = (size_t)height * width;
    // An integer in the lowest place of the float 2^23 adds its value to it: cheaper for a GPU than a conversion. No x
    // is below -1; but if the compiler knew these bits, it would move the selectors of bytes through registers instead.
    const unsigned float_2_23 = 0x4b000000u + (x < -1);
#if BYTES == 1
        struct Packed { WORD bytes; };
        auto value_of = [=](Packed pixel, int c) {
            return __uint_as_float(__byte_perm(pixel.bytes, float_2_23, 0x7440u | c));
        };
        auto is_counted = [](Packed pixel) { return pixel.bytes >> 8 * (PAD - 1) != 0; };
        const float zero = 8388608.f;
#elif BYTES == 2
        struct alignas(2 * PAD) Packed { unsigned pairs[PAD / 2]; };
        auto value_of = [=](const Packed& pixel, int c) {
            return __uint_as_float(__byte_perm(pixel.pairs[c / 2], float_2_23, c % 2 ? 0x7432u : 0x7410u));
        };
        auto is_counted = [](const Packed& pixel) { return pixel.pairs[PAD / 2 - 1] >> 16 != 0; };
        const float zero = 8388608.f;
#else
        struct alignas(PAD * sizeof(KEPT)) Packed { KEPT c[PAD]; };  // aligned, and so one load
        auto value_of = [](const Packed& pixel, int c) { return (float)pixel.c[c]; };
        auto is_counted = [](const Packed& pixel) { return (float)pixel.c[PAD - 1] != 0.f; };
        const float zero = 0.f;
#endif

    auto load = [](const Packed* place) {
        const WORDS words = __ldg((const WORDS*)place);
        Packed pixel;
        memcpy(&pixel, &words, sizeof(Packed));
        return pixel;
    };

    // Of rooted intensities 2 s (sqrt(1 + x / s) - 1) only the root is added up.
    const float inner = ROOTED ? 1.f / softness : 1.f, fade = 1.f / (1.f + gradient_weight);
    const float outer = fade * (ROOTED ? 2.f * softness : 1.f);
    const float of_slope = gradient_weight * (ROOTED ? 0.5f * inner : 1.f);
    auto rooted = [=](float x) {
        if (!ROOTED) return x;
        float root;  // one instruction; a root to the last bit takes ten
        asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(root) : "f"(1.f + inner * x));
        return root;
    };

    float color[STRIP + 2 * RIM][CHANNELS];
    #pragma unroll
    for (int r = 0; r < STRIP + 2 * RIM; ++r)
        for (int c = 0; c < CHANNELS; ++c)
            color[r][c] = image.data[within(y + r - RIM, height) * width + column].c[c];
    float cost[STRIP] = {}, number[STRIP] = {}, sums[SETS][STRIP] = {}, counts[SETS][STRIP] = {};

    for (int k = 0; k < count; ++k) {
        const float4 shift = ((const float4*)shifts.data)[l * count + k];
        const int dx = (int)shift.x, dy = (int)shift.y, n = order.data[k];
        const bool right = shift.z >= 0.5f, down = shift.w >= 0.5f;
        const unsigned x0 = within(column + dx, width), x1 = within(column + dx + 1, width), nearest = right ? x1 : x0;
        // Of what lies between two pixels, both are in the frame.
        const bool inside = (unsigned)(x + dx) < (unsigned)(width - (shift.z > 0.f));
        const unsigned rows_inside = height - (shift.w > 0.f);
        // Where the columns begin is worked out once for a view: if the compiler knew how, it would for every row. With
        // many sets there are too few registers to hold that, and to load ahead.
        const Packed* first_column = (const Packed*)views.data + n * plane + x0;
        const Packed* second_column = (const Packed*)views.data + n * plane + x1;
        const unsigned short* marked = (const unsigned short*)marks.data + n * plane + nearest;
        if (SEEN) asm("" : "+l"(first_column), "+l"(second_column), "+l"(marked));

        float upper[CHANNELS], before[CHANNELS] = {}, here[CHANNELS] = {};
        unsigned upper_mark, part = 0;  // of the nearest pixel: whether it is valid, or its mark
        auto interpolate = [&](int row, float* level, unsigned& mark) {
            const unsigned line = within(row, height) * width;  // one multiply-add makes an address of what is unsigned
            const Packed a = load(first_column + line), b = load(second_column + line);
            if (SEEN)
                mark = __ldg(marked + line);
            else
                mark = right ? is_counted(b) : is_counted(a);
            for (int c = 0; c < CHANNELS; ++c) {
                const float value = value_of(a, c);
                level[c] = value - zero + shift.z * (value_of(b, c) - value);
            }
        };
        interpolate(y - RIM + dy, upper, upper_mark);
        #pragma unroll
        for (int r = 0; r < STRIP + 2 * RIM; ++r) {  // row y + r - RIM becomes the one after
            float lower[CHANNELS], after[CHANNELS];
            unsigned lower_mark;
            interpolate(y + r - RIM + 1 + dy, lower, lower_mark);
            const unsigned next_part = down ? lower_mark : upper_mark;
            for (int c = 0; c < CHANNELS; ++c) {
                after[c] = scale * (upper[c] + shift.w * (lower[c] - upper[c])) - color[r][c];
                upper[c] = lower[c];
            }
            upper_mark = lower_mark;
            const int s = r - 2 * RIM, row = y + s;
            if (s >= 0) {
                const bool takes = inside && (unsigned)(row + dy) < rows_inside;
                float size = 0.f;
                for (int c = 0; c < CHANNELS; ++c) size += fabsf(RIM ? here[c] : after[c]);
                float robust = rooted(fminf(size * (1.f / CHANNELS), truncation));
                if (RIM) {
                    const bool first = s == 0 && row == 0, last = row == height - 1;
                    float slope = 0.f, along = 0.f;
                    for (int c = 0; c < CHANNELS; ++c) {
                        along += fabsf(__shfl_down_sync(~0u, here[c], 2) - here[c]);  // of the column to the right
                        slope += fabsf((last ? here[c] : after[c]) - (first ? here[c] : before[c]));
                    }
                    slope += __shfl_up_sync(~0u, along, 1);
                    robust += of_slope * fminf(slope * (0.25f / CHANNELS), gradient_truncation);
                }
                const unsigned now = RIM ? part : next_part;
                if (SEEN) {
                    if (takes && now <= l) {
                        sums[0][s] += robust;
                        counts[0][s] += 1.f;
                    }
                } else if (takes && now) {
                    cost[s] += robust;
                    number[s] += 1.f;
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

    if (lane < RIM || lane >= 32 - RIM || x >= width || part_of * (BLOCK / 32) + thread % BLOCK / 32 > l) return;
    const float most = outer * (rooted(truncation) + of_slope * gradient_truncation - ROOTED);
    auto mean = [=](float sum, float count) { return outer * (sum / count - ROOTED); };
    #pragma unroll
    for (int r = 0; r < STRIP; ++r) {
        if (y + r >= height) break;
        float lowest = counts[0][r] >= least ? mean(sums[0][r], counts[0][r]) : most;
        #pragma unroll
        for (int m = 1; m < SETS; ++m)
            if (counts[m][r] > 0.f)
                lowest = fminf(lowest, (1.f + preference) * mean(sums[m][r], counts[m][r]) + PENALTY);
        volume_out.data[l * plane + (size_t)(y + r) * width + x] = lowest;
    }
}
