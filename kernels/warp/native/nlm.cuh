// Weights and sums of non-local means on a GPU.
#pragma once
#include "lfgpu.h"
#include "nlm_plane.h"

// Weights of a tile of pixels and one neighbour of each; the distances stay in memory that the block shares.
void weigh_tile(
    int tid, Array2<Feature> features, Array1<vec2i> half_window, float floor, int is_mean, Array3<float> weights_out) {
    const int block = tid / (ROWS * COLUMNS), thread = tid - block * (ROWS * COLUMNS);
    const int down = (features.shape[0] + ROWS - 1) / ROWS, across = (features.shape[1] + COLUMNS - 1) / COLUMNS;
    const int k = block / (down * across), tile = block - k * down * across;
    const int top = tile / across * ROWS, left = tile % across * COLUMNS;
    __shared__ float distances[ROWS + 2 * RADIUS][COLUMNS + 2 * RADIUS];
    const int height = features.shape[0], width = features.shape[1];
    const int dy = half_window.data[k].c[0], dx = half_window.data[k].c[1];
    const int wide = COLUMNS + 2 * RADIUS;
    for (int i = thread; i < (ROWS + 2 * RADIUS) * wide; i += ROWS * COLUMNS) {
        const int y = top + i / wide - RADIUS, x = left + i % wide - RADIUS;
        float distance = 0.f;
        if (y >= 0 && y + dy < height && x >= 0 && x < width && x + dx >= 0 && x + dx < width) {
            const auto& here = features.data[y * width + x];
            const auto& there = features.data[(y + dy) * width + x + dx];
            for (int c = 0; c < FEATURES; ++c) {
                const float apart = here.c[c] - there.c[c];
                distance += apart * apart;
            }
        }
        distances[i / wide][i % wide] = distance;
    }
    __syncthreads();
    const int row = thread / COLUMNS, column = thread % COLUMNS, y = top + row, x = left + column;
    if (y >= height || x >= width) return;
    float weight = 0.f;
    if (y + dy < height && x + dx >= 0 && x + dx < width) {
        float total = 0.f;
        for (int j = 0; j <= 2 * RADIUS; ++j)
            for (int i = 0; i <= 2 * RADIUS; ++i) total += distances[row + j][column + i];
        const int rows = min(y + RADIUS, height - 1 - dy) - max(y - RADIUS, 0) + 1;
        const int columns = min(x + RADIUS, width - 1 - max(0, dx)) - max(x - RADIUS, max(0, -dx)) + 1;
        if (is_mean) total /= (float)(rows * columns);
        weight = fmaxf(expf(-total), floor);
    }
    weights_out.data[((size_t)k * height + y) * width + x] = weight;
}

// Add up TERM over the neighbours of a pixel; each warp of a block has one row of the half window.
void add_neighbors(
    int tid, Array3<float> weights, Array2<float> values, Array2<float> diagonal, Array2<float> sums_out) {
    // A block has a warp for each row of the half window, and all its warps the same 32 pixels.
    const int block = tid / (32 * (RADIUS + 1)), thread = tid - block * 32 * (RADIUS + 1);
    const int dy = thread / 32, lane = thread - dy * 32;
    const int columns = (values.shape[1] + 31) / 32, y = block / columns, x = (block - y * columns) * 32 + lane;
    __shared__ float parts[RADIUS + 1][32];
    const int height = values.shape[0], width = values.shape[1], p = y * width + x;
    const size_t size = (size_t)height * width;
    float total = 0.f;
    if (x < width) {
        const float here = values.data[p];
        const bool below = y + dy < height, above = y >= dy, inner = x >= RADIUS && x < width - RADIUS;
        const float* const down = values.data + p + dy * width;
        const float* const up = values.data + p - dy * width;
        // Of the row's first neighbour, dx = -RADIUS; the centre row begins at dx = 1, which is neighbour 0.
        const float* const w = weights.data + ((long long)dy * (2 * RADIUS + 1) - RADIUS - 1) * (long long)size + p;
        auto add = [&](float weight, float other) { total += weight * TERM; };
        if (below && above && inner && dy > 0) {  // nearly all; with nothing to decide, all reads are under way at once
            #pragma unroll
            for (int dx = -RADIUS; dx <= RADIUS; ++dx) {
                const float* const at = w + (dx + RADIUS) * size;
                add(at[0], down[dx]);
                add(at[-dy * width - dx], up[-dx]);
            }
        } else {
            #pragma unroll
            for (int dx = -RADIUS; dx <= RADIUS; ++dx) {
                if (dy == 0 && dx <= 0) continue;
                const float* const at = w + (dx + RADIUS) * size;
                if (below && (inner || (unsigned)(x + dx) < (unsigned)width)) add(at[0], down[dx]);
                if (above && (inner || (unsigned)(x - dx) < (unsigned)width)) add(at[-dy * width - dx], up[-dx]);
            }
        }
    }
    parts[dy][lane] = total;
    __syncthreads();
    if (dy == 0 && x < width) {
        total = (diagonal.data ? KEEP + diagonal.data[p] : KEEP) * values.data[p];
        for (int row = 0; row <= RADIUS; ++row) total += parts[row][lane];
        sums_out.data[p] = total;
    }
}

// Call add(weight, place, dx, dy) for the neighbours of a pixel in one row of the half window, and those across.
inline void for_neighbors(const auto& weights, int y, int x, int dy, int height, int width, auto add) {
    const size_t size = (size_t)height * width;
    const int p = y * width + x;
    const float* w = weights.data + ((long long)dy * (2 * RADIUS + 1) - RADIUS - 1) * (long long)size + p;
    #pragma unroll
    for (int dx = -RADIUS; dx <= RADIUS; ++dx, w += size) {
        if (dy == 0 && dx <= 0) continue;
        const int step = dy * width + dx;
        if (y + dy < height && (unsigned)(x + dx) < (unsigned)width) add(w[0], p + step, dx, dy);
        if (y >= dy && (unsigned)(x - dx) < (unsigned)width) add(w[-step], p - step, -dx, -dy);
    }
}

// A ratio of sums whose weights also depend on a guide.
void divide_sums(
    int tid, Array3<float> weights, Array2<float> guide, Array2<float> numerator, Array2<float> denominator,
    float support, Number floor, Array2<float> ratio_out) {
    // A block has a warp for each row of the half window, and all its warps the same 32 pixels.
    const int block = tid / (32 * (RADIUS + 1)), thread = tid - block * 32 * (RADIUS + 1);
    const int dy = thread / 32, lane = thread - dy * 32;
    const int columns = (guide.shape[1] + 31) / 32, y = block / columns, x = (block - y * columns) * 32 + lane;
    __shared__ float above[RADIUS + 1][32], below[RADIUS + 1][32];
    const int height = guide.shape[0], width = guide.shape[1], p = y * width + x;
    const float* const g = guide.data;
    const float* const a = numerator.data;
    const float* const b = denominator.data;
    const float weaken = 1.f / (support * support);
    float upper = 0.f, lower = 0.f;
    if (x < width) {
        const float here = g[p];
        auto add = [&](float weight, int q, int, int) {
            const float apart = g[q] - here, v = weight / (1.f + apart * apart * weaken);
            upper += v * a[q];
            lower += v * (b[q] + floor);
        };
        for_neighbors(weights, y, x, dy, height, width, add);
    }
    above[dy][lane] = upper;
    below[dy][lane] = lower;
    __syncthreads();
    if (dy == 0 && x < width) {
        upper = a[p];
        lower = b[p] + floor;
        for (int row = 0; row <= RADIUS; ++row) {
            upper += above[row][lane];
            lower += below[row][lane];
        }
        ratio_out.data[p] = upper / lower;
    }
}

// The plane through a map around a pixel.
void fit_planes(
    int tid, Array3<float> weights, Array2<float> values, Array2<float> certainty, float support, float ridge,
    Array2<float> plane_out) {
    // A block has a warp for each row of the half window, and all its warps the same 32 pixels.
    const int block = tid / (32 * (RADIUS + 1)), thread = tid - block * 32 * (RADIUS + 1);
    const int dy = thread / 32, lane = thread - dy * 32;
    const int columns = (values.shape[1] + 31) / 32, y = block / columns, x = (block - y * columns) * 32 + lane;
    __shared__ float parts[RADIUS + 1][9][32];
    const int height = values.shape[0], width = values.shape[1], p = y * width + x;
    const float* const d = values.data;
    const float* const c = certainty.data;
    const float weaken = 1.f / (support * support);
    float sums[9] = {};
    if (x < width) {
        const float here = d[p];
        auto add = [&](float weight, int q, float fx, float fy) {
            const float apart = d[q] - here, u = weight * c[q] / (1.f + apart * apart * weaken), ud = u * apart;
            sums[0] += u;
            sums[1] += fx * u;
            sums[2] += fy * u;
            sums[3] += fx * fx * u;
            sums[4] += fx * fy * u;
            sums[5] += fy * fy * u;
            sums[6] += ud;
            sums[7] += fx * ud;
            sums[8] += fy * ud;
        };
        for_neighbors(weights, y, x, dy, height, width, add);
    }
    for (int i = 0; i < 9; ++i) parts[dy][i][lane] = sums[i];
    __syncthreads();
    if (dy == 0 && x < width) {
        sums[0] += c[p];
        for (int row = 1; row <= RADIUS; ++row)
            for (int i = 0; i < 9; ++i) sums[i] += parts[row][i][lane];
        plane_out.data[p] = plane_at(d[p], sums, ridge);
    }
}
