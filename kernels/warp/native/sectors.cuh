// Costs by angular sector on a GPU: each thread has a pixel and a disparity, and all views of it.
#pragma once
#include "lfgpu.h"

// Compute the costs of FOLD rows at a disparity with each block, from the folded row `top` on. Views hold their masks
// in the last channel.
void find_sector_costs(
    int tid, Array3<Kept> views, Array2<Pixel> image, Array1<int> order, Array1<int> begins, Array1<vec2f> offsets,
    Array2<float> start, Array1<double> factor, float scale, float step, int top, Array3<Costs> costs_out) {
    constexpr int COSTS = 2 * SECTORS, ALL = FOLD * FOLD * COSTS, SIDE = BLOCK / FOLD;
    __shared__ STORED folded[SIDE / FOLD][ALL];
    const int height = image.shape[0], width = image.shape[1], rows = costs_out.shape[1], columns = costs_out.shape[2];
    const int thread = tid % BLOCK, block = tid / BLOCK, across = (columns * FOLD + SIDE - 1) / SIDE;
    const int labels = costs_out.shape[0], place = block / labels, l = block - place * labels;  // these see the same
    const int folded_y = top + place / across;
    const int i = thread / SIDE, j = thread % SIDE, left = place % across * SIDE;
    const int y = min(FOLD * folded_y + i, height - 1), x = min(left + j, width - 1), p = y * width + x;
    const float gain = (float)factor.data[0], stored_gain = gain * scale;
    const float disparity = start.data[p] + (float)l * step;
    const WORDS* const pixels = (const WORDS*)views.data;
    float reference[CHANNELS], costs[COSTS], sum_single = 0.f, sum_common = 0.f, sectors = 0.f;
    bool there[SECTORS];
    for (int c = 0; c < CHANNELS; ++c) reference[c] = gain * image.data[p].c[c];
    auto cost_of = [](float difference) { return 0.25f * logf(1.f + difference * (1.f / UNIT)); };
    // A value of a pixel. An integer in the lowest place of the float 2^23 adds its value to it, without a conversion.
    auto value_of = [](WORDS pixel, int c) {
#if BYTES == 1
        return __uint_as_float(__byte_perm(pixel, 0x4b000000u, 0x7440u | c)) - 8388608.f;
#elif BYTES == 2
        unsigned words[PAD / 2];
        memcpy(words, &pixel, sizeof(words));
        return __uint_as_float(__byte_perm(words[c / 2], 0x4b000000u, c % 2 ? 0x7432u : 0x7410u)) - 8388608.f;
#else
        KEPT values[PAD];
        memcpy(values, &pixel, sizeof(values));
        return (float)values[c];
#endif
    };

    #pragma unroll
    for (int s = 0; s < SECTORS; ++s) {
        float single = 0.f, common[CHANNELS], seen = 0.f;
        for (int c = 0; c < CHANNELS; ++c) common[c] = 0.f;
        for (int k = begins.data[s]; k < begins.data[s + 1]; ++k) {
            const auto offset = offsets.data[k];
            // The whole pixels of a shift and the rest apart: their sum with a column would have fewer digits.
            const float right = -disparity * offset.c[0], down = -disparity * offset.c[1];
            const float whole_x = floorf(right), whole_y = floorf(down), ax = right - whole_x, ay = down - whole_y;
            const int next = ax > 0.f, below = ay > 0.f;
            if (!(x + whole_x >= 0.f && x + whole_x + next <= width - 1 && y + whole_y >= 0.f)) continue;
            if (!(y + whole_y + below <= height - 1)) continue;
            const size_t upper = ((size_t)order.data[k] * height + y + (int)whole_y) * width + x + (int)whole_x;
            const size_t lower = upper + (below ? width : 0);
            const WORDS a = pixels[upper], b = pixels[upper + next], c = pixels[lower], d = pixels[lower + next];
            const WORDS nearest = ay >= 0.5f ? (ax >= 0.5f ? d : c) : (ax >= 0.5f ? b : a);
            if (value_of(nearest, PAD - 1) == 0.f) continue;
            #pragma unroll
            for (int i = 0; i < CHANNELS; ++i) {
                const float above = value_of(a, i), under = value_of(c, i);
                const float high = above + ax * (value_of(b, i) - above), low = under + ax * (value_of(d, i) - under);
                const float difference = stored_gain * (high + ay * (low - high)) - reference[i];
                single += fabsf(difference);
                common[i] += difference;
            }
            seen += 1.f;
        }
        there[s] = seen > 0.f;
        float sum = 0.f;
        for (int c = 0; c < CHANNELS; ++c) sum += fabsf(common[c]);
        const float share = 1.f / (CHANNELS * fmaxf(seen, 1.f));
        costs[s] = cost_of(single * share);
        costs[SECTORS + s] = cost_of(sum * share);
        sum_single += costs[s];  // 0 where no view takes part
        sum_common += costs[SECTORS + s];
        sectors += there[s] ? 1.f : 0.f;
    }
    const float mean_single = sectors > 0.f ? sum_single / sectors : 1.f;
    const float mean_common = sectors > 0.f ? sum_common / sectors : 1.f;
    STORED* const to = folded[j / FOLD] + FOLD * i + j % FOLD;
    #pragma unroll
    for (int s = 0; s < SECTORS; ++s) {
        to[FOLD * FOLD * s] = (STORED)(there[s] ? costs[s] : mean_single);
        to[FOLD * FOLD * (SECTORS + s)] = (STORED)(there[s] ? costs[SECTORS + s] : mean_common);
    }
    __syncthreads();
    const int some = min(SIDE, columns * FOLD - left) / FOLD * ALL;
    const size_t line = (size_t)l * rows + folded_y % rows;
    STORED* const out = (STORED*)costs_out.data + (line * columns + left / FOLD) * ALL;
    for (int k = thread; k < some; k += BLOCK) out[k] = folded[0][k];
}
