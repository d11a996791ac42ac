// What comes near in each view, on a CPU: it takes the window outside and pixels inside, many at a time.
#pragma once
#include "lfgpu.h"

// Forget what came near.
void clear(Array1<float> fronts_out) {
    for (int k = 0; k < fronts_out.shape[0]; ++k) fronts_out.data[k] = NOWHERE;
}

// Note where the pixels of a row land in a view, the nearest ones; `border` pixels around the frame belong to the
// z-buffer.
void land(int tid, Array2<float> disparity, Array1<vec2f> offsets, int first, int border, Array1<float> fronts_inout) {
    const int n = tid / disparity.shape[0], y = tid - n * disparity.shape[0];
    constexpr int CHUNK = 128;
    const float du = offsets.data[first + n].c[0], dv = offsets.data[first + n].c[1];
    const int height = disparity.shape[0], width = disparity.shape[1];
    const int wide = width + 2 * border, high = height + 2 * border;
    float* const front = fronts_inout.data + (size_t)n * high * wide;
    for (int begin = 0; begin < width; begin += CHUNK) {
        const float* const ds = disparity.data + (size_t)y * width + begin;
        const int count = wp::min(CHUNK, width - begin);
        int places[CHUNK];
        for (int i = 0; i < count; ++i) {
            // The shift is split before the column is added: a small number keeps its digits.
            const float shift_x = -ds[i] * du, shift_y = -ds[i] * dv;
            const float whole_x = floorf(shift_x), whole_y = floorf(shift_y);
            const float x = whole_x + (shift_x - whole_x >= 0.5f ? 1.f : 0.f) + (float)(begin + i + border);
            const float to_y = whole_y + (shift_y - whole_y >= 0.5f ? 1.f : 0.f) + (float)(y + border);
            const bool inside = (x >= 0.f) & (x < (float)wide) & (to_y >= 0.f) & (to_y < (float)high);
            places[i] = inside ? (int)to_y * wide + (int)x : -1;
        }
        for (int i = 0; i < count; ++i)
            if (places[i] >= 0 && front[places[i]] < ds[i]) front[places[i]] = ds[i];
    }
}

// The nearest disparity around each pixel of a row of a view; one pixel farther out where nothing is.
void look_around(int tid, Array1<float> fronts, int reach, Array3<float> nearest_out) {
    const int n = tid / nearest_out.shape[1], y = tid - n * nearest_out.shape[1];
    constexpr int ROOM = 256;
    const int height = nearest_out.shape[1], width = nearest_out.shape[2];
    const int side = 2 * reach + 3, wide = width + side - 1;
    const float* __restrict__ const front = fronts.data + (size_t)n * (height + side - 1) * wide + (size_t)y * wide;
    float* __restrict__ const out = nearest_out.data + ((size_t)n * height + y) * width;
    // Down the columns first, and then along the row.
    float highest[ROOM];
    for (int begin = 0, most = ROOM - 2 * reach; begin < width; begin += most) {
        const int many = width - begin < most ? width - begin : most;
        for (int k = 0; k < many + 2 * reach; ++k) highest[k] = NOWHERE;
        for (int j = 1; j < side - 1; ++j) {
            const float* __restrict__ const row = front + j * wide + 1 + begin;
            for (int k = 0; k < many + 2 * reach; ++k) highest[k] = highest[k] < row[k] ? row[k] : highest[k];
        }
        for (int k = 0; k < many; ++k) out[begin + k] = highest[k];
        for (int i = 1; i <= 2 * reach; ++i)
            for (int k = 0; k < many; ++k)
                out[begin + k] = out[begin + k] < highest[k + i] ? highest[k + i] : out[begin + k];
    }
    for (int x = 0; x < width; ++x)
        if (out[x] <= NOWHERE)
            for (int j = 0; j < side; ++j)
                for (int i = 0; i < side; ++i) out[x] = wp::max(out[x], front[j * wide + x + i]);
}
