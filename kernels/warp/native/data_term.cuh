// The data term on a GPU: a tile of one view is predicted, compared and followed back within one block of threads.
//
// A block splats what lands on its tile into shared memory, where it becomes the residual, and gathers from there the
// gradient of those pixels whose four taps its tile holds; the residuals never leave the chip. The prediction is added
// up in whole numbers, which shared memory adds fast, and in which the order does not matter: the result has the same
// bits each time. What each view says about the gradient is written where no other writes, and added up in order.
//
// The disparity and the image are kept in strips, one for each warp of threads. The smallest and largest disparity of a
// strip tell a block whether it has to look at it.
#pragma once
#include "lfgpu.h"

constexpr int BIAS = 0x4B400000;  // the bits of 1.5 * 2^23: a number added to that is rounded, and is in the bits

// Where a pixel of disparity `d` lands along one axis: the pixel before (and BIAS), and `rest` from the middle between
// it and the next one.
//
// The shift is d * offset against the offset. Small numbers are split before the column is added, and so keep their
// digits.
inline int place(float d, float offset, float& rest) {
    const float from_middle = fmaf(-d, offset, -0.5f), rounded = from_middle + __int_as_float(BIAS);
    rest = from_middle - (rounded - __int_as_float(BIAS));
    return __float_as_int(rounded);
}

// Raise `most_out` to the largest value of a warp; of numbers that are not negative the larger one has the larger
// bits.
void raise_to(float value, int lane, Array1<float> most_out) {
    for (int step = 16; step; step >>= 1) value = fmaxf(value, __shfl_xor_sync(~0u, value, step));
    if (lane == 0) atomicMax((int*)most_out.data, __float_as_int(value));
}

// The disparity in strips, and its range in each strip and in each of PARTS parts.
void find_ranges(
    int tid, Array2<float> disparity, Array1<float> strips_out, Array1<vec2f> ranges_out, Array1<vec2f> parts_out) {
    const int block = tid / BLOCK, thread = tid - block * BLOCK;
    // Each warp takes strips; out of the frame the nearest pixel's disparity stands, which widens no range.
    __shared__ float lows[BLOCK / 32], highs[BLOCK / 32];
    const int height = disparity.shape[0], width = disparity.shape[1], lane = thread & 31;
    const int columns = (width + COLUMNS) / COLUMNS, count = columns * ((height + ROWS - 1) / ROWS);
    float lowest = INFINITY, highest = -INFINITY;
    for (int strip = block * (BLOCK / 32) + (thread >> 5); strip < count; strip += PARTS * (BLOCK / 32)) {
        const int row = strip / columns, x = min(max((strip - row * columns) * COLUMNS + lane - 1, 0), width - 1);
        float low = INFINITY, high = -INFINITY;
        for (int r = 0; r < ROWS; ++r) {
            const float d = disparity.data[min(row * ROWS + r, height - 1) * width + x];
            strips_out.data[strip * STRIP + r * 32 + lane] = d;
            low = fminf(low, d);
            high = fmaxf(high, d);
            if (isnan(d)) lowest = -INFINITY;  // and so the value, in the end, is not a number
        }
        for (int step = 16; step; step >>= 1) {
            low = fminf(low, __shfl_xor_sync(~0u, low, step));
            high = fmaxf(high, __shfl_xor_sync(~0u, high, step));
        }
        if (lane == 0) ranges_out.data[strip].c[0] = low, ranges_out.data[strip].c[1] = high;
        lowest = fminf(lowest, low);
        highest = fmaxf(highest, high);
    }
    for (int step = 16; step; step >>= 1) lowest = fminf(lowest, __shfl_xor_sync(~0u, lowest, step));
    if (lane == 0) lows[thread >> 5] = lowest, highs[thread >> 5] = highest;
    __syncthreads();
    if (thread == 0) {
        for (int i = 1; i < BLOCK / 32; ++i) {
            lowest = fminf(lowest, lows[i]);
            highest = fmaxf(highest, highs[i]);
        }
        parts_out.data[block].c[0] = lowest, parts_out.data[block].c[1] = highest;
    }
}

// The squared error of a tile, and what its view says about the gradient.
void evaluate_tile(
    int tid, Array1<Padded> image, Array1<float> most, Array1<float> disparity, Array1<vec2f> ranges,
    Array1<vec2f> parts, Array1<vec2f> offsets, Array3<Kept> recorded, float softness, float scale, int height,
    int width, int tiles_y, int tiles_x, int tile_height, int tile_width, Array2<float> gradients_out,
    Array1<double> squares_out) {
    const int block = tid / BLOCK, thread = tid - block * BLOCK;
    struct alignas(PAD * sizeof(float)) Color { float c[PAD]; };  // aligned, and so one load
    struct alignas(PAD * sizeof(KEPT)) Packed { KEPT c[PAD]; };
    typedef WORDS Words;  // of the same size
    constexpr int WARPS = BLOCK / 32, AREA = (TILE_ROWS + 2) * PITCH, SIZE = CHANNELS * AREA + PITCH + 4;
    // Around a tile lie a row and a column for taps that are another tile's. The rows below one channel are those above
    // the next, the columns to the right those to the left of the next row.
    __shared__ alignas(16) int sums[SIZE];
    __shared__ int list[LIST];
    __shared__ int listed;
    __shared__ double squared[WARPS];
    const int lane = thread & 31, warp = thread >> 5;
    const int columns = (width + COLUMNS) / COLUMNS, rows = (height + ROWS - 1) / ROWS;
    const int n = block / (tiles_x * tiles_y), tile = block - n * tiles_x * tiles_y, tile_y = tile / tiles_x;
    // The first tile begins at -1, where the right or lower taps of a pixel may be the only ones in the frame.
    const int x0 = (tile - tile_y * tiles_x) * tile_width - 1, y0 = tile_y * tile_height - 1;
    const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
    const Color* const colors = (const Color*)image.data;

    for (int i = thread; i < SIZE / 4; i += BLOCK) ((int4*)sums)[i] = make_int4(0, 0, 0, 0);
    if (thread == 0) listed = 0;
    float lowest = INFINITY, highest = -INFINITY;
    for (int i = lane; i < PARTS; i += 32) {
        lowest = fminf(lowest, parts.data[i].c[0]);
        highest = fmaxf(highest, parts.data[i].c[1]);
    }
    for (int step = 16; step; step >>= 1) {
        lowest = fminf(lowest, __shfl_xor_sync(~0u, lowest, step));
        highest = fmaxf(highest, __shfl_xor_sync(~0u, highest, step));
    }
    // What lands on a pixel lies along a line as long as the disparities differ, in a band up to four pixels wide, and
    // has no part larger than 1: so much, times the largest value, is the most that a sum can be.
    const float reach = (highest - lowest) * fmaxf(fabsf(du), fabsf(dv));
    const float largest = fmaxf(most.data[0], 1e-20f) * 4.f * (reach + 3.f);
    const float unit = exp2f(floorf(30.f - log2f(largest))), value_of_one = 1.f / unit;

    auto before = [&](float low, float high, float offset) {
        return floorf(fmaxf(fminf(-low * offset, -high * offset), -1e6f)) - 1.f;
    };
    auto after = [&](float low, float high, float offset) {
        return floorf(fminf(fmaxf(-low * offset, -high * offset), 1e6f)) + 1.f;
    };
    const int first_x = max(0, x0 - 1 - (int)after(lowest, highest, du)) / COLUMNS;
    const int last_x = min(min(width, x0 + tile_width + 1 - (int)before(lowest, highest, du)) / COLUMNS, columns - 1);
    const int first_y = max(0, y0 - 1 - (int)after(lowest, highest, dv)) / ROWS;
    const int last_y = min(min(height - 1, y0 + tile_height - (int)before(lowest, highest, dv)) / ROWS, rows - 1);
    const int wide = max(0, last_x - first_x + 1), candidates = wide * max(0, last_y - first_y + 1);

    auto look_at = [&](int first) {
        // Lists those of the next LIST strips that may land on the tile or beside it; their order does not matter.
        for (int i = first + thread; i < min(first + LIST, candidates); i += BLOCK) {
            const int down = i / wide, sx = first_x + i - down * wide, sy = first_y + down;
            const float low = ranges.data[sy * columns + sx].c[0], high = ranges.data[sy * columns + sx].c[1];
            if (sx * COLUMNS - 1 + before(low, high, du) <= x0 + tile_width &&
                sx * COLUMNS + COLUMNS - 1 + after(low, high, du) >= x0 - 1 &&
                sy * ROWS + before(low, high, dv) <= y0 + tile_height &&
                sy * ROWS + ROWS - 1 + after(low, high, dv) >= y0 - 1)
                list[atomicAdd(&listed, 1)] = (sy << 16) + sx;
        }
        __syncthreads();
    };
    auto look_further = [&](int first) {
        __syncthreads();
        if (thread == 0) listed = 0;
        __syncthreads();
        look_at(first);
    };

    const float edge = 0.5f - softness, k = 0.5f / softness, s = 1.f / (1.f - softness);
    auto bend = [&](float rest) { return rest - fmaxf(fminf(rest, edge), -edge); };  // how far into a rounded kink
    auto tent = [&](float rest, float bent) { return 0.5f - s * (rest - k * bent * fabsf(bent)); };

    __syncthreads();
    for (int first = 0; first < candidates; first += LIST) {
        if (first)
            look_further(first);
        else
            look_at(0);
        for (int i = warp; i < listed; i += WARPS) {
            const int sy = list[i] >> 16, sx = list[i] & 0xffff, begin = (sy * columns + sx) * STRIP + lane;
            // Places count from the surplus row and column.
            const int column = sx * COLUMNS + lane - x0 - BIAS, row = sy * ROWS - y0 + 1 - BIAS;
            constexpr int nowhere = -(1 << 30);
            auto add = [&](int at, const float* value) {
                for (int c = 0; c < CHANNELS; ++c) atomicAdd(sums + c * AREA + at, __float2int_rn(value[c]));
            };
            // What goes to the right is handed to the next lane where that one adds to the same pixel, and what goes
            // below is kept for the row below: most pixels get one addition for each pixel that lands on them.
            int kept_at = nowhere;
            float d[ROWS], kept[CHANNELS] = {};
            for (int r = 0; r < ROWS; ++r) d[r] = disparity.data[begin + r * 32];
            Color color, next = colors[begin];  // asked for a row before it is needed
            #pragma unroll
            for (int r = 0; r < ROWS; ++r) {
                color = next;
                if (r + 1 < ROWS) next = colors[begin + (r + 1) * 32];
                float rest_x, rest_y;
                const int x = place(d[r], du, rest_x) + column, y = place(d[r], dv, rest_y) + row + r;
                const bool here = (unsigned)x < (unsigned)(tile_width + 2) && (unsigned)y < (unsigned)(tile_height + 2);
                const int at = here ? y * PITCH + x : nowhere;
                if (!__any_sync(~0u, here)) continue;
                const float wx = tent(rest_x, bend(rest_x)) * unit, wy = tent(rest_y, bend(rest_y));
                float left[CHANNELS], right[CHANNELS], upper[CHANNELS], lower[CHANNELS];
                for (int c = 0; c < CHANNELS; ++c) {
                    left[c] = color.c[c] * wx;
                    right[c] = color.c[c] * (unit - wx);
                }
                const int at_before = __shfl_up_sync(~0u, at, 1);
                const float wy_before = __shfl_up_sync(~0u, wy, 1);
                const bool takes = lane > 0 && at_before + 1 == at;
                const unsigned takers = __ballot_sync(~0u, takes);  // all lanes together, whatever comes of the answer
                const bool taken = (takers >> 1 >> lane) & 1;
                const float share_above = takes ? wy_before : 0.f, share_below = takes ? 1.f - wy_before : 0.f;
                for (int c = 0; c < CHANNELS; ++c) {
                    const float handed = __shfl_up_sync(~0u, right[c], 1);
                    upper[c] = left[c] * wy;
                    lower[c] = left[c] - upper[c] + handed * share_below;
                    upper[c] += handed * share_above;
                }
                if (!here) continue;
                if (!taken && lane < 31) {
                    for (int c = 0; c < CHANNELS; ++c) left[c] = right[c] * wy;
                    add(at + 1, left);
                    for (int c = 0; c < CHANNELS; ++c) left[c] = right[c] - left[c];
                    add(at + 1 + PITCH, left);
                }
                if (lane == 0) continue;
                if (kept_at == at)
                    for (int c = 0; c < CHANNELS; ++c) upper[c] += kept[c];
                else if (kept_at != nowhere)
                    add(kept_at, kept);
                add(at, upper);
                kept_at = at + PITCH;
                for (int c = 0; c < CHANNELS; ++c) kept[c] = lower[c];
            }
            if (kept_at != nowhere) add(kept_at, kept);
        }
    }
    __syncthreads();

    // The residual takes the place of the sums; the row and column that the next tiles have too are compared here for
    // the gradient and there for the value.
    float* const residual = (float*)sums;
    float square = 0.f;
    for (int y = warp; y <= tile_height; y += WARPS) {
        const Words* const in = (const Words*)recorded.data + ((size_t)n * height + y0 + y) * width + x0;
        Words words[PITCH / 32];
        #pragma unroll
        for (int j = 0; j < PITCH / 32; ++j) {
            const int x = lane + 32 * j;
            const bool there = (unsigned)(x0 + x) < (unsigned)width && (unsigned)(y0 + y) < (unsigned)height;
            words[j] = there && x <= tile_width ? __ldcs(in + x) : Words{};  // read once: it shall not fill the cache
        }
        #pragma unroll
        for (int j = 0; j < PITCH / 32; ++j) {
            const int x = lane + 32 * j;
            if (x > tile_width) continue;
            const Packed packed = *(const Packed*)&words[j];
            const float counts = (float)packed.c[PAD - 1];
            float sum = 0.f;
            for (int c = 0; c < CHANNELS; ++c) {
                const int at = c * AREA + (y + 1) * PITCH + x + 1;
                const float rest = counts * ((float)sums[at] * value_of_one - scale * (float)packed.c[c]);
                residual[at] = rest;
                sum += rest * rest;
            }
            if (y < tile_height && x < tile_width) square += sum;
        }
    }
    double total = square;
    for (int step = 16; step; step >>= 1) total += __shfl_xor_sync(~0u, total, step);
    if (lane == 0) squared[warp] = total;
    __syncthreads();
    if (thread == 0) {
        for (int i = 1; i < WARPS; ++i) total += squared[i];
        squares_out.data[block] = total;
    }

    const float slope_x = du * s, slope_y = dv * s;
    for (int first = 0; first < candidates; first += LIST) {
        if (candidates > LIST) look_further(first);
        for (int i = warp; i < listed; i += WARPS) {
            const int sy = list[i] >> 16, sx = list[i] & 0xffff, begin = (sy * columns + sx) * STRIP + lane;
            const int column = sx * COLUMNS + lane - 1 - x0 - BIAS, row = sy * ROWS - y0 - BIAS;
            float* const out = gradients_out.data + (size_t)n * columns * rows * STRIP + begin;
            float d[ROWS];
            for (int r = 0; r < ROWS; ++r) d[r] = disparity.data[begin + r * 32];
            Color color, next = colors[begin];
            #pragma unroll
            for (int r = 0; r < ROWS; ++r) {
                color = next;
                if (r + 1 < ROWS) next = colors[begin + (r + 1) * 32];
                float rest_x, rest_y;
                const int x = place(d[r], du, rest_x) + column, y = place(d[r], dv, rest_y) + row + r;
                if (lane == 0 || (unsigned)x >= (unsigned)tile_width || (unsigned)y >= (unsigned)tile_height) continue;
                const float* tap = residual + (y + 1) * PITCH + x + 1;
                float a00 = 0.f, a01 = 0.f, a10 = 0.f, a11 = 0.f;
                for (int c = 0; c < CHANNELS; ++c, tap += AREA) {
                    a00 += color.c[c] * tap[0];
                    a01 += color.c[c] * tap[1];
                    a10 += color.c[c] * tap[PITCH];
                    a11 += color.c[c] * tap[PITCH + 1];
                }
                const float bend_x = bend(rest_x), bend_y = bend(rest_y);
                const float wx = tent(rest_x, bend_x), wy = tent(rest_y, bend_y);
                const float sx_ = slope_x - slope_x / softness * fabsf(bend_x);
                const float sy_ = slope_y - slope_y / softness * fabsf(bend_y);
                const float upper = a00 - a01, lower = a10 - a11, left = a00 - a10, right = a01 - a11;
                out[r * 32] = sx_ * (lower + wy * (upper - lower)) + sy_ * (right + wx * (left - right));
            }
        }
    }
}

// Add up the gradient over the views; the first block adds up the value as well.
void add_up(
    int tid, Array2<float> gradients, Array1<float> disparity, Array1<vec2f> offsets, Array1<double> squares,
    Array2<float> gradient_out, Array1<double> value_out) {
    const int block = tid / BLOCK, thread = tid - block * BLOCK;
    // A pixel that lands out of the frame was no tile's, and what is there for it is old.
    const int height = gradient_out.shape[0], width = gradient_out.shape[1], i = block * BLOCK + thread;
    const int columns = (width + COLUMNS) / COLUMNS, rows = (height + ROWS - 1) / ROWS, size = columns * rows * STRIP;
    if (i < size) {
        const int strip = i / STRIP, row = strip / columns, lane = i & 31;
        const int x = (strip - row * columns) * COLUMNS + lane - 1, y = row * ROWS + (i - strip * STRIP) / 32;
        const float d = disparity.data[i], *said = gradients.data + i;
        float total = 0.f, rest;
        #pragma unroll 16
        for (int n = 0; n < offsets.shape[0]; ++n, said += size) {
            const float by_view = *said;  // read before it is known to count
            const int tap_x = place(d, offsets.data[n].c[0], rest) + x + 1 - BIAS;
            const int tap_y = place(d, offsets.data[n].c[1], rest) + y + 1 - BIAS;
            total += (unsigned)tap_x <= (unsigned)width && (unsigned)tap_y <= (unsigned)height ? by_view : 0.f;
        }
        if (lane > 0 && x < width && y < height) gradient_out.data[y * width + x] = 2.f * total;
    }
    if (block > 0) return;
    __shared__ double squared[BLOCK / 32];
    double all = 0.0;
    for (int j = thread; j < squares.shape[0]; j += BLOCK) all += squares.data[j];
    for (int step = 16; step; step >>= 1) all += __shfl_xor_sync(~0u, all, step);
    if ((thread & 31) == 0) squared[thread >> 5] = all;
    __syncthreads();
    if (thread > 0) return;
    for (int j = 1; j < BLOCK / 32; ++j) all += squared[j];
    value_out.data[0] = all;
}
