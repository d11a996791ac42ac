// Averages of like pixels on a GPU.
#pragma once
#include "lfgpu.h"

// Average a pixel in SLICES slices of the volume, for which a thread reads the weights once.
void average_pixel(int tid, Array3<float> weights, Array3<float> volume, Array3<float> average_out) {
    const int height = volume.shape[1], width = volume.shape[2], count = volume.shape[0];
    const int block = tid / (ROWS * COLUMNS), thread = tid - block * (ROWS * COLUMNS);
    const int parts = (count + SLICES - 1) / SLICES, columns = (width + COLUMNS - 1) / COLUMNS;
    const int tile = block / parts;  // blocks of the same pixels follow each other and find their weights in the cache
    const int part = block - tile * parts, row = tile / columns;
    const int y = row * ROWS + thread / COLUMNS, x = (tile - row * columns) * COLUMNS + thread % COLUMNS;
    const int first = count * part / parts, last = count * (part + 1) / parts, p = y * width + x;
    if (y >= height || x >= width) return;
    const long long size = (long long)height * width;
    const float* slices[SLICES];
    float sums[SLICES], total = 1.f;
    #pragma unroll
    for (int s = 0; s < SLICES; ++s) {
        slices[s] = volume.data + min(first + s, last - 1) * size + p;  // the last one again where there are fewer
        sums[s] = slices[s][0];
    }
    const bool inner = x >= RADIUS && x < width - RADIUS;
    for (int dy = -RADIUS; dy <= RADIUS; ++dy) {
        if ((unsigned)(y + dy) >= (unsigned)height) continue;
        #pragma unroll
        for (int dx = -RADIUS; dx <= RADIUS; ++dx) {
            if ((dy == 0 && dx == 0) || !(inner || (unsigned)(x + dx) < (unsigned)width)) continue;
            const bool after = dy > 0 || (dy == 0 && dx > 0);
            const int k = (after ? dy * SIDE + dx : -dy * SIDE - dx) - 1, q = dy * width + dx;
            const float w = weights.data[k * size + p + (after ? 0 : q)];
            total += w;
            #pragma unroll
            for (int s = 0; s < SLICES; ++s) sums[s] += w * slices[s][q];
        }
    }
    #pragma unroll
    for (int s = 0; s < SLICES; ++s)
        if (first + s < last) average_out.data[(first + s) * size + p] = sums[s] / total;
}
