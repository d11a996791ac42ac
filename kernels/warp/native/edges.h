// Weights that are small beside steps in brightness, on a CPU.
#pragma once
#include "lfgpu.h"

// A row.
void weigh_edges(
    int tid, Array2<Pixel> image, float weight, Number contrast, int row, int lanes, Array2<float> weights_out) {
    const int y = row + tid / lanes;
    constexpr int ROOM = 256, MOST = ROOM - 2 * REACH;
    const int height = image.shape[0], width = image.shape[1];
    const int top = wp::max(y - REACH, 0), bottom = wp::min(y + REACH, height - 1);
    auto step_between = [](const auto& one, const auto& other) {
        float size = 0.f;
        for (int c = 0; c < CHANNELS; ++c) size += wp::abs(one.c[c] - other.c[c]);
        return size / CHANNELS;
    };
    // Down the columns first, and then along the row.
    float beside[ROOM], below[ROOM];
    for (int begin = 0; begin < width; begin += MOST) {
        const int from = wp::max(begin - REACH, 0), many = wp::min(begin + MOST + REACH, width) - from;
        for (int k = 0; k < many; ++k) beside[k] = below[k] = 0.f;
        for (int v = top; v <= bottom; ++v) {
            const auto* const line = image.data + (size_t)v * width + from;
            for (int k = 0; k < many - 1; ++k) beside[k] = wp::max(beside[k], step_between(line[k], line[k + 1]));
            if (v < bottom)
                for (int k = 0; k < many; ++k) below[k] = wp::max(below[k], step_between(line[k], line[k + width]));
        }
        for (int x = begin; x < wp::min(begin + MOST, width); ++x) {
            const int left = wp::max(x - REACH, 0) - from, right = wp::min(x + REACH, width - 1) - from;
            float largest = below[right];
            for (int k = left; k < right; ++k) largest = wp::max(largest, wp::max(beside[k], below[k]));
            const float share = largest / contrast;
            weights_out.data[(size_t)y * width + x] = weight / (1.f + share * share);
        }
    }
}
