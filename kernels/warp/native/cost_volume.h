// Cost volumes: averages of like pixels on a CPU; on any device, the costs of reduced views, the least cost and its
// place.
#pragma once
#include "lfgpu.h"

// Average the rows from `first` to before `last`.
//
// The weights of a block of columns are gathered once, for all slices of the volume: where they lie, each in a picture
// of its own, they would drive each other out of the cache.
void average_rows(
    Array3<float> weights, Array3<float> volume, int first, int last, Array1<float> room, Array3<float> average_out) {
    const int height = volume.shape[1], width = volume.shape[2], count = volume.shape[0];
    const size_t size = (size_t)height * width;
    float* __restrict__ gathered = room.data;
    for (int y = first; y < last; ++y) {
        const int top = y < RADIUS ? -y : -RADIUS, bottom = height - 1 - y < RADIUS ? height - 1 - y : RADIUS;
        for (int x0 = 0; x0 < width; x0 += BLOCK) {
            const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
            const bool inner = x0 >= RADIUS && x0 + BLOCK + RADIUS <= width;
            float total[BLOCK] = {};
            float* to = gathered;
            for (int dy = top; dy <= bottom; ++dy)
                for (int dx = -RADIUS; dx <= RADIUS; ++dx, to += BLOCK) {
                    // Of each pair the second pixel finds the weight at the first.
                    const bool after = dy > 0 || (dy == 0 && dx > 0), itself = dy == 0 && dx == 0;
                    const int k = (after ? dy * SIDE + dx : -dy * SIDE - dx) - 1;
                    const long long from = after ? y * width + x0 : (y + dy) * width + x0 + dx;
                    for (int j = 0; j < BLOCK; ++j) {
                        const bool inside = j < columns && x0 + j + dx >= 0 && x0 + j + dx < width;
                        to[j] = !inside ? 0.f : itself ? 1.f : weights.data[k * (long long)size + from + j];
                        total[j] += to[j];
                    }
                }
            for (int l = 0; l < count; ++l) {
                const float* __restrict__ slice = volume.data + l * size;
                float* __restrict__ result = average_out.data + l * size + y * width + x0;
                const float* w = gathered;
                if (inner) {
                    float sum[BLOCK] = {};
                    for (int dy = top; dy <= bottom; ++dy) {
                        const float* other = slice + (y + dy) * width + x0 - RADIUS;
                        for (int dx = 0; dx < SIDE; ++dx, ++other, w += BLOCK)
                            for (int j = 0; j < BLOCK; ++j) sum[j] += w[j] * other[j];
                    }
                    for (int j = 0; j < BLOCK; ++j) result[j] = sum[j] / total[j];
                } else {
                    float sum[BLOCK] = {};
                    for (int dy = top; dy <= bottom; ++dy)
                        for (int dx = -RADIUS; dx <= RADIUS; ++dx, w += BLOCK) {
                            const float* other = slice + (y + dy) * width;
                            const int begin = x0 + dx < 0 ? -x0 - dx : 0;
                            const int end = x0 + columns + dx > width ? width - x0 - dx : columns;
                            for (int j = begin; j < end; ++j) sum[j] += w[j] * other[x0 + dx + j];
                        }
                    for (int j = 0; j < columns; ++j) result[j] = sum[j] / total[j];
                }
            }
        }
    }
}

// Add the costs of reduced views to a row.
//
// Along it, REDUCTION pixels lie on one of the reduced volume, between the centres of this one and its neighbours.
void add_reduced(
    int tid, Array3<float> reduced, Array2<float> shares, float weight, int row, int lanes,
    Array3<float> volume_inout) {
    const int y = row + tid / lanes, lane = tid % lanes;
    const int height = volume_inout.shape[1], width = volume_inout.shape[2];
    const int rows = reduced.shape[1], columns = reduced.shape[2];
    const float at = ((float)y + 0.5f) / REDUCTION - 0.5f;
    const float place = at < 0.f ? 0.f : at > rows - 1 ? (float)(rows - 1) : at;
    const int upper = (int)place, lower = upper + 1 < rows ? upper + 1 : upper;
    const float down = weight * (place - upper), up = weight - down;
    const float* __restrict__ const share_above = shares.data + (size_t)upper * columns;
    const float* __restrict__ const share_below = shares.data + (size_t)lower * columns;
    for (int l = 0; l < volume_inout.shape[0]; ++l) {
        const float* __restrict__ const above = reduced.data + ((size_t)l * rows + upper) * columns;
        const float* __restrict__ const below = reduced.data + ((size_t)l * rows + lower) * columns;
        float* __restrict__ const out = volume_inout.data + ((size_t)l * height + y) * width;
        for (int k = lane; k * REDUCTION < width; k += lanes) {
            const int here = k < columns ? k : columns - 1;
            const int before = k < 1 ? 0 : k - 1 < here ? k - 1 : here, after = k + 1 < columns ? k + 1 : columns - 1;
            auto at = [&](int i) { return up * share_above[i] * above[i] + down * share_below[i] * below[i]; };
            const float left = at(before), middle = at(here), right = at(after);
            #pragma unroll
            for (int j = 0; j < REDUCTION; ++j) {
                const float away = (j + 0.5f) / REDUCTION - 0.5f;
                const int x = k * REDUCTION + j;
                if (x < width) out[x] += middle + (away < 0.f ? -away * (left - middle) : away * (right - middle));
            }
        }
    }
}

// The least cost of pixels of a row, BLOCK columns at a time.
void find_least(int tid, Array3<float> volume, int row, int lanes, Array2<float> least_out) {
    const int width = volume.shape[2], count = volume.shape[0];
    const size_t size = (size_t)volume.shape[1] * width;
    const int y = row + tid / lanes;
    for (int x = tid % lanes * BLOCK; x < width; x += lanes * BLOCK) {
        const int columns = width - x < BLOCK ? width - x : BLOCK;
        const float* const costs = volume.data + (size_t)y * width + x;
        float* const out = least_out.data + (size_t)y * width + x;
        float found[BLOCK];
        for (int j = 0; j < columns; ++j) found[j] = costs[j];
        for (int l = 1; l < count; ++l)
            for (int j = 0; j < columns; ++j)
                found[j] = costs[l * size + j] < found[j] ? costs[l * size + j] : found[j];
        for (int j = 0; j < columns; ++j) out[j] = found[j];
    }
}

// The disparity of the least cost, by a parabola through it and its neighbours.
void find_lowest(
    int tid, Array3<float> volume, Number labels, Number first, float step, int row, int lanes,
    Array2<float> disparity_out) {
    const int width = volume.shape[2], count = (int)labels;
    const size_t size = (size_t)volume.shape[1] * width;
    const int y = row + tid / lanes;
    for (int x = tid % lanes * BLOCK; x < width; x += lanes * BLOCK) {
        const int columns = width - x < BLOCK ? width - x : BLOCK;
        const float* const costs = volume.data + (size_t)y * width + x;
        float least[BLOCK];
        int places[BLOCK];
        for (int j = 0; j < columns; ++j) {
            least[j] = costs[j];
            places[j] = 0;
        }
        for (int l = 1; l < count; ++l)
            for (int j = 0; j < columns; ++j) {
                const float cost = costs[l * size + j];
                const bool less = cost < least[j];
                places[j] = less ? l : places[j];
                least[j] = less ? cost : least[j];
            }
        for (int j = 0; j < columns; ++j) {
            const int k = places[j] < 1 ? 1 : places[j] > count - 2 ? count - 2 : places[j];
            const float* const here = costs + k * size + j;
            // Differences first: what the costs have in common has no part in their rounding.
            const float down = here[0] - *(here - size), up = here[size] - here[0], bend = up - down;
            float t = bend > 1e-9f ? -(up + down) / (2.f * bend) : 0.f;
            t = t < -1.f ? -1.f : t > 1.f ? 1.f : t;
            disparity_out.data[(size_t)y * width + x + j] = first + step * (k + t);
        }
    }
}
