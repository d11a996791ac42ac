// The peak of the distribution of each pixel over disparities, on a CPU.
#pragma once
#include "exponential.h"

// Find the peaks of the folded rows from `first` to before `last` of those from `top` on, a chunk of pixels at a time.
void find_peaks(
    Array3<Logits> logits, Array2<float> start, float step, int top, int first, int last,
    Array2<float> disparity_out, Array2<float> probability_out, Array2<float> deviation_out) {
    constexpr int PIXELS = FOLD * FOLD, CHUNK = 16 * PIXELS, NEAR = 2 * REACH + 1;
    const int labels = logits.shape[0], rows = logits.shape[1], columns = logits.shape[2];
    const int height = start.shape[0], width = start.shape[1];
    const size_t slice = (size_t)rows * columns * PIXELS;
    float most[CHUNK], total[CHUNK], near[NEAR][CHUNK], found[3][CHUNK];
    int best[CHUNK];
    for (int row = top + first; row < top + last; ++row)
        for (int left = 0; left < columns; left += CHUNK / PIXELS) {
            const int pixels = columns - left < CHUNK / PIXELS ? (columns - left) * PIXELS : CHUNK;
            const STORED* const from = (const STORED*)logits.data + ((size_t)(row % rows) * columns + left) * PIXELS;
            for (int j = 0; j < CHUNK; ++j) {
                most[j] = -INFINITY;
                best[j] = 0;
                total[j] = 0.f;
            }
            for (int l = 0; l < labels; ++l) {
                #pragma clang loop vectorize(assume_safety)
                for (int j = 0; j < pixels; ++j) {
                    const float value = from[l * slice + j];
                    best[j] = value > most[j] ? l : best[j];
                    most[j] = value > most[j] ? value : most[j];
                }
            }
            for (int l = 0; l < labels; ++l) {
                #pragma clang loop vectorize(assume_safety)
                for (int j = 0; j < pixels; ++j) total[j] += exp_of((float)from[l * slice + j] - most[j]);
            }
            for (int k = 0; k < NEAR; ++k)
                for (int j = 0; j < pixels; ++j) {
                    const int l = best[j] + k - REACH;
                    near[k][j] = l >= 0 && l < labels ? (float)from[l * slice + j] - most[j] : -INFINITY;
                }
            #pragma clang loop vectorize(assume_safety)
            for (int j = 0; j < pixels; ++j) {
                float shares[NEAR], sum = 0.f, place = 0.f, square = 0.f;
                for (int k = 0; k < NEAR; ++k) {
                    shares[k] = near[k][j] > -87.f ? exp_of(near[k][j]) : 0.f;
                    sum += shares[k];
                    place += (k - REACH) * shares[k];
                }
                place /= sum;
                for (int k = 0; k < NEAR; ++k) square += (k - REACH - place) * (k - REACH - place) * shares[k];
                found[0][j] = step * (best[j] + place);
                found[1][j] = sum / total[j];
                found[2][j] = step * __builtin_sqrtf(square / sum);
            }
            for (int j = 0; j < pixels; ++j) {
                const int y = FOLD * row + j % PIXELS / FOLD, x = FOLD * (left + j / PIXELS) + j % FOLD;
                if (y >= height || x >= width) continue;
                const size_t p = (size_t)y * width + x;
                disparity_out.data[p] = start.data[p] + found[0][j];
                probability_out.data[p] = found[1][j];
                deviation_out.data[p] = found[2][j];
            }
        }
}
