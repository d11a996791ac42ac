// Convolutions of volumes on a CPU.
//
// A thread computes some rows, several groups of MANY pixels at a time: all their sums stay in registers, so that each
// weight that is read serves all of these groups, and each number of the volume all channels of the output. What a few
// rows need of the volume is copied first, as floats and with zeros beyond the border.
//
// Where a window has three taps along a row, a group is four pixels, which take six products instead of twelve: sums of
// the volume (BEFORE) times sums of the weights, and sums of these (AFTER), as Winograd found.
#pragma once
#include "lfgpu.h"

// Compute some of the rows [l, y]: of these, in which y is one of `some` from `top` on, those from `first` to before
// `last`. The volume has so much `height`; a row of `added` is for `high` rows. Weights are [TERMS, KL, KY, TAPS, CI,
// PADDED].
void convolve_rows(
    Array3<In> volume, Array1<float> weights, Array1<float> bias, Array3<Added> added, int top, int some, int height,
    int high, int first, int last, Array3<Out> volume_out) {
#ifdef __AVX512F__
    constexpr int LANES = 16, REGISTERS = 26;
#else
    constexpr int LANES = 8, REGISTERS = 12;
#endif
    constexpr int ROWS = 4, TALL = (ROWS - 1) * SY + KY;  // rows that share copies
    constexpr int PARTS = (CO + LANES - 1) / LANES, MOST = REGISTERS > PARTS ? REGISTERS / PARTS : 1;
    constexpr bool PLAIN = TERMS == 1;
    constexpr int GROUPS = PLAIN ? (MOST < 12 ? MOST : 12) : 1 << (31 - __builtin_clz(MOST));
    constexpr int PIXELS = GROUPS * MANY, WINDOW = (MANY - 1) * SX + KX;
    constexpr int NEEDED = ((PIXELS - 1) * SX + KX) * CI;  // of a row of the volume
    constexpr int BETWEEN = PLAIN ? SX * CI : CI;  // groups of a copy
    constexpr float before[TERMS][WINDOW] = {BEFORE}, after[MANY][TERMS] = {AFTER};
    typedef float Lanes __attribute__((vector_size(4 * LANES), aligned(4)));

    const int labels = volume.shape[0], held = volume.shape[1], width = volume.shape[2];
    const int rows = volume_out.shape[1], columns = volume_out.shape[2];
    const STORED* const from = (const STORED*)volume.data;
    const STORED* const more = (const STORED*)added.data;
    RESULT* const to = (RESULT*)volume_out.data;
    const int deep = more ? volume_out.shape[0] / added.shape[0] : 1, apart = more ? columns / added.shape[2] : 1;
    float line[NEEDED], copies[TERMS][KL * TALL][PLAIN ? NEEDED : GROUPS * CI];
    Lanes results[GROUPS][MANY][PARTS];

    for (int row = first, next; row < last; row = next) {
        const int l = row / some, y = top + row - l * some;
        next = wp::min(wp::min(row + ROWS, (l + 1) * some), last);
        for (int x = 0; x < columns; x += PIXELS) {
            const int left = x * SX - KX / 2;  // the first pixel that is needed
            const int begin = left < 0 ? -left * CI : 0, there = (width - left) * CI;
            const int end = there < NEEDED ? there : NEEDED;
            for (int k = 0; k < KL * TALL; ++k) {
                const int tl = l * SL + k / TALL - KL / 2, ty = y * SY + k % TALL - KY / 2;
                const bool inside = tl >= 0 && tl < labels && ty >= 0 && ty < height;
                const STORED* const source = from + (((long long)tl * held + ty % held) * width + left) * CI;
                float* const copy = PLAIN ? copies[0][k] : line;
                if (inside && begin == 0 && end == NEEDED) {
                    for (int i = 0; i < NEEDED; ++i) copy[i] = (float)source[i];
                } else {
                    for (int i = 0; i < NEEDED; ++i) copy[i] = 0.f;
                    for (int i = begin; inside && i < end; ++i) copy[i] = (float)source[i];
                }
                for (int j = 0; !PLAIN && j < GROUPS; ++j)
                    #pragma clang loop vectorize(assume_safety)
                    for (int i = 0; i < CI; ++i)
                        #pragma unroll
                        for (int t = 0; t < TERMS; ++t) {
                            float sum = 0.f;
                            #pragma unroll
                            for (int w = 0; w < WINDOW; ++w)
                                if (before[t][w] != 0.f) sum += before[t][w] * line[(j * MANY * SX + w) * CI + i];
                            copies[t][k][j * CI + i] = sum;
                        }
            }

            for (int r = 0; r < next - row; ++r) {
                for (int j = 0; j < PIXELS; ++j)
                    for (int v = 0; v < PARTS; ++v)
                        results[j / MANY][j % MANY][v] = *(const Lanes*)(bias.data + v * LANES);
                const float* weight = weights.data;
                #pragma unroll
                for (int t = 0; t < TERMS; ++t) {
                    Lanes sums[GROUPS][PARTS];
                    #pragma unroll
                    for (int j = 0; j < GROUPS; ++j)
                        #pragma unroll
                        for (int v = 0; v < PARTS; ++v) sums[j][v] = Lanes{};
                    for (int k = 0; k < KL * KY; ++k) {
                        const float* const copy = copies[t][k / KY * TALL + r * SY + k % KY];
                        for (int i = 0; i < TAPS * CI; ++i, weight += PADDED)
                            #pragma unroll
                            for (int j = 0; j < GROUPS; ++j)
                                #pragma unroll
                                for (int v = 0; v < PARTS; ++v)
                                    sums[j][v] += *(const Lanes*)(weight + v * LANES) * copy[j * BETWEEN + i];
                    }
                    #pragma unroll
                    for (int j = 0; j < GROUPS; ++j)
                        #pragma unroll
                        for (int m = 0; m < MANY; ++m)
                            #pragma unroll
                            for (int v = 0; v < PARTS; ++v)
                                if (after[m][t] != 0.f) results[j][m][v] += after[m][t] * sums[j][v];
                }

                const int more_row = more ? l / deep * added.shape[1] + (y + r) / high % added.shape[1] : 0;
                RESULT* const out = to + (((size_t)l * rows + (y + r) % rows) * columns + x) * CO;
                for (int j = 0; j < PIXELS && x + j < columns; ++j) {
                    float* const result = (float*)results[j / MANY][j % MANY];
                    if (more) {
                        const STORED* const other = more + ((size_t)more_row * added.shape[2] + (x + j) / apart) * CO;
                        for (int c = 0; c < CO; ++c) result[c] += (float)other[c];
                    }
                    #pragma clang loop vectorize(assume_safety)
                    for (int c = 0; c < CO; ++c)
                        out[j * CO + c] = (RESULT)(RECTIFIED && result[c] < 0.f ? 0.f : result[c]);
                }
            }
        }
    }
}
