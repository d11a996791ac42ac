// The peak of the distribution of each pixel over disparities, on a GPU.
#pragma once
#include "lfgpu.h"

// Find the peak of a pixel, of those from `first` on.
void find_peak(
    int tid, Array3<Logits> logits, Array2<float> start, float step, int first, Array2<float> disparity_out,
    Array2<float> probability_out, Array2<float> deviation_out) {
    constexpr int NEAR = 2 * REACH + 1, PIXELS = FOLD * FOLD;
    const int labels = logits.shape[0], columns = logits.shape[2], width = start.shape[1];
    const int p = first + tid, y = p / width, x = p - y * width;
    const size_t slice = (size_t)logits.shape[1] * columns * PIXELS;
    const int row = y / FOLD % logits.shape[1];
    const STORED* const from =
        (const STORED*)logits.data + ((size_t)row * columns + x / FOLD) * PIXELS + y % FOLD * FOLD + x % FOLD;
    float most = (float)from[0], total = 0.f;
    int best = 0;
    for (int l = 1; l < labels; ++l) {
        const float value = (float)from[l * slice];
        if (value > most) {
            most = value;
            best = l;
        }
    }
    for (int l = 0; l < labels; ++l) total += expf((float)from[l * slice] - most);
    float shares[NEAR], sum = 0.f, place = 0.f, square = 0.f;
    #pragma unroll
    for (int k = 0; k < NEAR; ++k) {
        const int l = best + k - REACH;
        shares[k] = l >= 0 && l < labels ? expf((float)from[l * slice] - most) : 0.f;
        sum += shares[k];
        place += (k - REACH) * shares[k];
    }
    place /= sum;
    #pragma unroll
    for (int k = 0; k < NEAR; ++k) square += (k - REACH - place) * (k - REACH - place) * shares[k];
    disparity_out.data[p] = start.data[p] + step * (best + place);
    probability_out.data[p] = sum / total;
    deviation_out.data[p] = step * sqrtf(square / sum);
}
