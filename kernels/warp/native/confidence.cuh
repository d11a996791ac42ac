// Means along an axis, on a GPU.
#pragma once
#include "lfgpu.h"

void average_line(
    int tid, Array2<float> values, int down, int across, int reach, int row, int lanes, Array2<float> means_out) {
    const int y = row + tid / lanes, lane = tid % lanes;
    const int height = values.shape[0], width = values.shape[1], step = down * width + across;
    for (int x = lane; x < width; x += lanes) {
        const int place = down ? y : x, size = down ? height : width;
        const int from = place < reach ? -place : -reach, to = size - 1 - place < reach ? size - 1 - place : reach;
        const float* const here = values.data + (size_t)y * width + x;
        float total = 0.f;
        for (int k = from; k <= to; ++k) total += here[k * step];
        means_out.data[(size_t)y * width + x] = total / (float)(to - from + 1);
    }
}
