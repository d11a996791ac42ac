// Means of pixels that look alike, on a GPU.
#pragma once
#include "lfgpu.h"

// The stored value of an intensity.
inline unsigned short stored(float value) {
    const float inside = value < 0.f ? 0.f : value > 1.f ? 1.f : value;
    return (unsigned short)(WHITE * inside + 0.5f);
}

// Smooth a tile of a view in `order`, or of all: a block has it, and what is around it, in shared memory.
void smooth_tile(
    int tid, Array3<Stored> views, Array3<float> valid, Array1<int> order, float scale, Number deviation,
    Array3<Smoothed> views_out) {
    const int block = tid / THREADS, thread = tid - block * THREADS;
    const int rows = (views.shape[1] + ROWS - 1) / ROWS, columns = (views.shape[2] + COLUMNS - 1) / COLUMNS;
    const int n = block / (rows * columns), tile = block - n * rows * columns;
    const int top = tile / columns * ROWS, left = tile % columns * COLUMNS;
    constexpr float near[] = {NEAR};
    constexpr int tall = ROWS + 2 * REACH, wide = COLUMNS + 2 * REACH;
    __shared__ float colors[CHANNELS][tall + 2][wide + 2], guides[CHANNELS][tall][wide];
    __shared__ float knowns[tall + 2][wide + 2], counts[tall][wide];  // 1 where valid; counts: 0 outside the frame
    const int height = views.shape[1], width = views.shape[2];
    const long long view = (long long)(order.data ? order.data[n] : n) * height * width;
    const float unit = 1.f / (CHANNELS * deviation * deviation);
    for (int i = thread; i < (tall + 2) * (wide + 2); i += THREADS) {
        const int y = i / (wide + 2), x = i - y * (wide + 2);
        const int row = min(max(top + y - REACH - 1, 0), height - 1);
        const int column = min(max(left + x - REACH - 1, 0), width - 1);
        const long long place = view + (long long)row * width + column;
        const bool known = !valid.data || valid.data[place] != 0.f;
        knowns[y][x] = known ? 1.f : 0.f;
        const auto value = views.data[place];
        for (int c = 0; c < CHANNELS; ++c) colors[c][y][x] = known ? scale * (float)value.c[c] : 0.f;
    }
    __syncthreads();
    for (int i = thread; i < tall * wide; i += THREADS) {
        const int y = i / wide, x = i - y * wide, row = top + y - REACH, column = left + x - REACH;
        float share = 0.f;
        for (int dy = 0; dy < 3; ++dy)
            for (int dx = 0; dx < 3; ++dx) share += knowns[y + dy][x + dx];
        share = 1.f / max(share, 1.f);
        for (int c = 0; c < CHANNELS; ++c) {
            float sum = 0.f;
            for (int dy = 0; dy < 3; ++dy)
                for (int dx = 0; dx < 3; ++dx) sum += colors[c][y + dy][x + dx];
            guides[c][y][x] = sum * share;
        }
        const bool inside = (unsigned)row < (unsigned)height && (unsigned)column < (unsigned)width;
        counts[y][x] = inside ? knowns[y + 1][x + 1] : 0.f;
    }
    __syncthreads();
    // PIXELS of a column at once: what is around them is read once for all.
    const int y = thread / COLUMNS * PIXELS, x = thread % COLUMNS;
    float sums[PIXELS][CHANNELS] = {}, weights[PIXELS] = {}, guide[PIXELS][CHANNELS], likeness[PIXELS];
    for (int j = 0; j < PIXELS; ++j) {
        for (int c = 0; c < CHANNELS; ++c) guide[j][c] = guides[c][y + j + REACH][x + REACH];
        likeness[j] = unit * counts[y + j + REACH][x + REACH];
    }
    #pragma unroll
    for (int row = 0; row < 2 * REACH + PIXELS; ++row)
        #pragma unroll
        for (int dx = 0; dx <= 2 * REACH; ++dx) {
            float other[CHANNELS], color[CHANNELS];
            for (int c = 0; c < CHANNELS; ++c) {
                other[c] = guides[c][y + row][x + dx];
                color[c] = colors[c][y + row + 1][x + dx + 1];
            }
            const float count = counts[y + row][x + dx];
            #pragma unroll
            for (int j = 0; j < PIXELS; ++j) {
                const int dy = row - j;
                if (dy < 0 || dy > 2 * REACH) continue;
                float difference = 0.f;
                for (int c = 0; c < CHANNELS; ++c) {
                    const float apart = other[c] - guide[j][c];
                    difference += apart * apart;
                }
                const float unlike = 1.f + likeness[j] * difference;
                const float weight = __fdividef(near[dy] * near[dx] * count, unlike * unlike);
                for (int c = 0; c < CHANNELS; ++c) sums[j][c] += weight * color[c];
                weights[j] += weight;
            }
        }
    for (int j = 0; j < PIXELS; ++j) {
        if (top + y + j >= height || left + x >= width) continue;
        auto& out = views_out.data[((long long)n * height + top + y + j) * width + left + x];
        for (int c = 0; c < CHANNELS; ++c) out.c[c] = stored(weights[j] > 0.f ? sums[j][c] / weights[j] : 0.f);
    }
}
