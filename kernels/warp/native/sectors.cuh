// Costs by angular sector on a GPU: each warp has a strip of a few rows and 32 columns at a disparity, and all views.
//
// The warps of a block have the same strip at neighbouring disparities: what they read of a view is nearly the same.
// A thread goes down its column. Where its pixels have one disparity, what it interpolated between two columns of a row
// of the view serves the pixels above and below.
#pragma once
#include "lfgpu.h"

// Compute the costs of HIGH folded rows at BLOCK / 32 disparities with each block, from the folded row `top` on, of
// which there are `some`. Views that are MASKED hold their masks in the last channel.
void find_sector_costs(
    int tid, Array3<Kept> views, Array2<Pixel> image, Array1<int> order, Array1<int> begins, Array1<vec2f> offsets,
    Array2<float> start, Array1<double> factor, float scale, float step, int top, int some, Array3<Costs> costs_out) {
    constexpr int COSTS = 2 * SECTORS, SQUARE = FOLD * FOLD, ALL = SQUARE * COSTS, WIDE = 32 / FOLD, ROWS = FOLD * HIGH;
    constexpr int WORD = sizeof(unsigned) / sizeof(STORED), APART = ALL + WORD;  // so that pixels are in other banks
    constexpr float FAR = 1e6f;  // pixels: farther than any frame
    alignas(16) __shared__ STORED kept[BLOCK / 32 * HIGH * WIDE * APART];
    const int height = image.shape[0], width = image.shape[1], rows = costs_out.shape[1], columns = costs_out.shape[2];
    const int lane = tid % 32, warp = tid % BLOCK / 32, block = tid / BLOCK, across = (columns + WIDE - 1) / WIDE;
    const int labels = costs_out.shape[0], groups = (labels + BLOCK / 32 - 1) / (BLOCK / 32);
    const int place = block / groups, l = (block - place * groups) * (BLOCK / 32) + warp;
    const int first = place / across * HIGH, left = place % across * WIDE;
    const int x = min(FOLD * left + lane, width - 1), y = FOLD * (top + first);
    const float gain = (float)factor.data[0], stored_gain = gain * scale;

    // A value of a pixel. An integer in the lowest place of the float 2^23 adds its value to it, without a conversion.
    struct Packed { WORDS words; };
    auto value_of = [](Packed pixel, int c) {
#if BYTES == 1
        return __uint_as_float(__byte_perm(pixel.words, 0x4b000000u, 0x7440u | c));
#elif BYTES == 2
        unsigned words[PAD / 2];
        memcpy(words, &pixel, sizeof(words));
        return __uint_as_float(__byte_perm(words[c / 2], 0x4b000000u, c % 2 ? 0x7432u : 0x7410u));
#else
        KEPT values[PAD];
        memcpy(values, &pixel, sizeof(values));
        return (float)values[c];
#endif
    };
    constexpr float ZERO = BYTES ? 8388608.f : 0.f;

    // Where the views are looked at for a pixel, and what is there between two columns of a row.
    struct Shift { int right, down; float ax, ay; bool inside; };
    struct Line { float values[CHANNELS]; bool counts; };
    auto shift_of = [&](float disparity, float u, float v) {
        // The whole pixels of a shift and the rest apart: their sum with a column would have fewer digits.
        const float right = fminf(fmaxf(-disparity * u, -FAR), FAR), down = fminf(fmaxf(-disparity * v, -FAR), FAR);
        const float whole_x = floorf(right), whole_y = floorf(down);
        Shift shift = {(int)whole_x, (int)whole_y, right - whole_x, down - whole_y, true};
        shift.inside = x + shift.right >= 0 && x + shift.right + (shift.ax > 0.f) < width;
        return shift;
    };
    auto line_at = [&](const Packed* here, int next, const Shift& shift) {
        const Packed one = {__ldg((const WORDS*)here)}, other = {__ldg((const WORDS*)(here + next))};
        Line line;
        for (int c = 0; c < CHANNELS; ++c) {
            const float value = value_of(one, c);
            line.values[c] = value - ZERO + shift.ax * (value_of(other, c) - value);
        }
        line.counts = !MASKED || value_of(shift.ax >= 0.5f ? other : one, PAD - 1) != ZERO;
        return line;
    };
    auto line_of = [&](const Packed* view, const Shift& shift, int row) {
        const int column = min(max(x + shift.right, 0), width - 1);
        const Packed* const here = view + min(max(row, 0), height - 1) * width + column;
        return line_at(here, column + 1 < width, shift);
    };

    float reference[ROWS][CHANNELS], disparity[ROWS];
    bool is_level = y + ROWS <= height;
    #pragma unroll
    for (int r = 0; r < ROWS; ++r) {
        const int p = min(y + r, height - 1) * width + x;
        disparity[r] = start.data[p] + (float)l * step;
        is_level = is_level && disparity[r] == disparity[0];
        for (int c = 0; c < CHANNELS; ++c) reference[r][c] = gain * image.data[p].c[c];
    }

    auto cost_of = [](float difference) { return 0.25f * logf(1.f + difference * (1.f / UNIT)); };
    float sum_single[ROWS] = {}, sum_common[ROWS] = {};
    unsigned there[ROWS] = {};  // a bit for each sector
    STORED* const to = kept + (warp * HIGH * WIDE + lane / FOLD) * APART + lane % FOLD;
    auto place_in = [](int r, int s) { return r / FOLD * WIDE * APART + FOLD * (r % FOLD) + SQUARE * s; };
    #pragma unroll 1
    for (int s = 0; s < SECTORS; ++s) {
        float single[ROWS] = {}, common[ROWS][CHANNELS] = {}, seen[ROWS] = {};
        auto add = [&](int r, const Shift& shift, bool is_there, const Line& upper, const Line& lower) {
            const bool counts = is_there && (!MASKED || (shift.ay >= 0.5f ? lower : upper).counts);
            seen[r] += counts ? 1.f : 0.f;
            #pragma unroll
            for (int c = 0; c < CHANNELS; ++c) {
                const float value = upper.values[c] + shift.ay * (lower.values[c] - upper.values[c]);
                const float difference = counts ? stored_gain * value - reference[r][c] : 0.f;
                single[r] += fabsf(difference);
                common[r][c] += difference;
            }
        };
        for (int k = begins.data[s]; k < begins.data[s + 1]; ++k) {
            const float u = offsets.data[k].c[0], v = offsets.data[k].c[1];
            const Packed* const view = (const Packed*)views.data + (size_t)order.data[k] * height * width;
            auto is_there = [&](const Shift& shift, int row) {
                return shift.inside && row >= 0 && row + (shift.ay > 0.f) < height;
            };
            if (!is_level) {
                #pragma unroll
                for (int r = 0; r < ROWS; ++r) {
                    const Shift shift = shift_of(disparity[r], u, v);
                    const int row = min(y + r, height - 1) + shift.down;
                    const Line upper = line_of(view, shift, row), lower = line_of(view, shift, row + 1);
                    add(r, shift, is_there(shift, row), upper, lower);
                }
                continue;
            }
            const Shift shift = shift_of(disparity[0], u, v);
            const int row = y + shift.down;
            Line lines[ROWS + 1];
            if (shift.inside && x + shift.right + 1 < width && row >= 0 && row + ROWS < height) {
                const Packed* const here = view + row * width + x + shift.right;
                #pragma unroll
                for (int r = 0; r <= ROWS; ++r) lines[r] = line_at(here + r * width, 1, shift);
                #pragma unroll
                for (int r = 0; r < ROWS; ++r) add(r, shift, true, lines[r], lines[r + 1]);
            } else {
                #pragma unroll
                for (int r = 0; r <= ROWS; ++r) lines[r] = line_of(view, shift, row + r);
                #pragma unroll
                for (int r = 0; r < ROWS; ++r) add(r, shift, is_there(shift, row + r), lines[r], lines[r + 1]);
            }
        }
        #pragma unroll
        for (int r = 0; r < ROWS; ++r) {
            if (seen[r] == 0.f) continue;
            float sum = 0.f;
            for (int c = 0; c < CHANNELS; ++c) sum += fabsf(common[r][c]);
            const float share = 1.f / (CHANNELS * seen[r]);
            const float own = cost_of(single[r] * share), together = cost_of(sum * share);
            to[place_in(r, s)] = (STORED)own;
            to[place_in(r, SECTORS + s)] = (STORED)together;
            sum_single[r] += own;
            sum_common[r] += together;
            there[r] |= 1u << s;
        }
    }
    #pragma unroll
    for (int r = 0; r < ROWS; ++r) {
        float sectors = 0.f;
        for (int s = 0; s < SECTORS; ++s) sectors += (float)(there[r] >> s & 1u);
        const float mean_single = sectors > 0.f ? sum_single[r] / sectors : 1.f;
        const float mean_common = sectors > 0.f ? sum_common[r] / sectors : 1.f;
        for (int s = 0; s < SECTORS; ++s) {
            if (there[r] >> s & 1u) continue;
            to[place_in(r, s)] = (STORED)mean_single;
            to[place_in(r, SECTORS + s)] = (STORED)mean_common;
        }
    }
    __syncwarp();
    if (l >= labels) return;
    constexpr int OF_PIXEL = ALL / WORD;
    const int many = min(WIDE, columns - left) * OF_PIXEL;
    for (int r = 0; r < min(HIGH, some - first); ++r) {
        const size_t line = (size_t)l * rows + (top + first + r) % rows;
        unsigned* const out = (unsigned*)((STORED*)costs_out.data + (line * columns + left) * ALL);
        const STORED* const from = kept + (warp * HIGH + r) * WIDE * APART;
        for (int k = lane; k < many; k += 32) out[k] = ((const unsigned*)(from + k / OF_PIXEL * APART))[k % OF_PIXEL];
    }
}
