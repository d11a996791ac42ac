// Weights that are small beside steps in brightness, on a GPU.
#pragma once
#include "lfgpu.h"

// A pixel.
void weigh_edges(
    int tid, Array2<Pixel> image, float weight, Number contrast, int row, int lanes, Array2<float> weights_out) {
    const int height = image.shape[0], width = image.shape[1], y = row + tid / lanes, x = tid % lanes;
    const int left = max(x - REACH, 0), right = min(x + REACH, width - 1);
    const int top = max(y - REACH, 0), bottom = min(y + REACH, height - 1);
    auto step_between = [&](int p, int q) {
        float size = 0.f;
        for (int c = 0; c < CHANNELS; ++c) size += fabsf(image.data[p].c[c] - image.data[q].c[c]);
        return size / CHANNELS;
    };
    float largest = 0.f;
    for (int v = top; v <= bottom; ++v)
        for (int u = left; u <= right; ++u) {
            const int p = v * width + u;
            if (u < right) largest = fmaxf(largest, step_between(p, p + 1));
            if (v < bottom) largest = fmaxf(largest, step_between(p, p + width));
        }
    const float share = largest / contrast;
    weights_out.data[y * width + x] = weight / (1.f + share * share);
}
