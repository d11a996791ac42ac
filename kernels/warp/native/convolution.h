// Convolutions of volumes on a CPU.
//
// A thread computes some rows, several pixels at a time: all sums of these stay in registers, so that each weight that
// is read serves all of these pixels, and each number of the volume all channels of the output. What the pixels need of
// the volume is copied first, as floats and with zeros beyond the border. Where channels are few, SPREAD is KX instead
// of one: the taps of a row are channels as well, each for a pixel beside it, and are added up at the end.
#pragma once
#include "lfgpu.h"

// Compute some of the rows [l, y]: of these, in which y is one of `some` from `top` on, those from `first` to before
// `last`. The volume has so much `height`; a row of `added` is for `high` rows. Weights are [KL, KY, TAPS, CI, PADDED].
void convolve_rows(
    Array3<In> volume, Array1<float> weights, Array1<float> bias, Array3<Added> added, int top, int some, int height,
    int high, int first, int last, Array3<Out> volume_out) {
    #pragma clang fp contract(fast)
#ifdef __AVX512F__
    constexpr int LANES = 16, REGISTERS = 26;
#else
    constexpr int LANES = 8, REGISTERS = 12;
#endif
    constexpr int PARTS = (CO * SPREAD + LANES - 1) / LANES, TAPS = KX / SPREAD;
    constexpr int PIXELS = REGISTERS >= 2 * PARTS ? (REGISTERS / PARTS < 12 ? REGISTERS / PARTS : 12) : 1;
    constexpr int NEEDED = ((PIXELS - 1) * SX + KX) * CI;  // of a row of the volume
    constexpr int PLACES = PIXELS + SPREAD - 1;
    typedef float Lanes __attribute__((vector_size(4 * LANES), aligned(4)));

    const int labels = volume.shape[0], held = volume.shape[1], width = volume.shape[2];
    const int rows = volume_out.shape[1], columns = volume_out.shape[2];
    const STORED* const from = (const STORED*)volume.data;
    const STORED* const more = (const STORED*)added.data;
    RESULT* const to = (RESULT*)volume_out.data;
    float patch[KL * KY][NEEDED], results[PLACES][PARTS * LANES];

    for (int row = first; row < last; ++row) {
        const int l = row / some, y = top + row - l * some;
        const STORED* more_row = nullptr;
        int apart = 1;
        if (more) {
            const int deep = volume_out.shape[0] / added.shape[0];
            apart = columns / added.shape[2];
            more_row = more + ((size_t)(l / deep) * added.shape[1] + y / high % added.shape[1]) * added.shape[2] * CO;
        }
        for (int x = 0; x < columns; x += PIXELS) {
            const int left = x * SX - KX / 2;  // the first pixel that is needed
            const int begin = left < 0 ? -left * CI : 0, there = (width - left) * CI;
            const int end = there < NEEDED ? there : NEEDED;
            for (int k = 0; k < KL * KY; ++k) {
                const int tl = l * SL + k / KY - KL / 2, ty = y * SY + k % KY - KY / 2;
                float* const part = patch[k];
                if (tl < 0 || tl >= labels || ty < 0 || ty >= height) {
                    for (int i = 0; i < NEEDED; ++i) part[i] = 0.f;
                    continue;
                }
                const STORED* const source = from + (((long long)tl * held + ty % held) * width + left) * CI;
                if (begin == 0 && end == NEEDED) {
                    for (int i = 0; i < NEEDED; ++i) part[i] = (float)source[i];
                } else {
                    for (int i = 0; i < begin; ++i) part[i] = 0.f;
                    for (int i = begin; i < end; ++i) part[i] = (float)source[i];
                    for (int i = end; i < NEEDED; ++i) part[i] = 0.f;
                }
            }

            Lanes sums[PLACES][PARTS];
            #pragma unroll
            for (int j = 0; j < PLACES; ++j)
                #pragma unroll
                for (int v = 0; v < PARTS; ++v) sums[j][v] = Lanes{};
            const float* weight = weights.data;
            for (int k = 0; k < KL * KY; ++k) {
                const float* const part = patch[k];
                for (int i = 0; i < TAPS * CI; ++i, weight += PADDED) {
                    Lanes here[PARTS];
                    #pragma unroll
                    for (int v = 0; v < PARTS; ++v) here[v] = *(const Lanes*)(weight + v * LANES);
                    #pragma unroll
                    for (int j = 0; j < PLACES; ++j)
                        #pragma unroll
                        for (int v = 0; v < PARTS; ++v) sums[j][v] += here[v] * part[j * SX * CI + i];
                }
            }

            #pragma unroll
            for (int j = 0; j < PLACES; ++j)
                #pragma unroll
                for (int v = 0; v < PARTS; ++v) *(Lanes*)(results[j] + v * LANES) = sums[j][v];
            for (int j = 0; j < PIXELS && x + j < columns; ++j) {
                float result[CO];
                for (int c = 0; c < CO; ++c) {
                    result[c] = bias.data[c];
                    for (int s = 0; s < SPREAD; ++s) result[c] += results[j + s][s * CO + c];
                }
                if (more) {
                    const STORED* const other = more_row + (x + j) / apart * CO;
                    for (int c = 0; c < CO; ++c) result[c] += (float)other[c];
                }
                RESULT* const out = to + (((size_t)l * rows + y % rows) * columns + x + j) * CO;
                for (int c = 0; c < CO; ++c) out[c] = (RESULT)(RECTIFIED && result[c] < 0.f ? 0.f : result[c]);
            }
        }
    }
}
