// What comes near in each view, on a GPU: a thread has a pixel, and the views one after the other.
//
// As bits that are ordered as the floats are, 0 is less than any disparity: memory is cleared the fastest way, and the
// nearest disparity is found by one operation.
#pragma once
#include "lfgpu.h"

// Note where a pixel lands in `count` views.
void land(int tid, Array2<float> disparity, Array1<vec2f> offsets, int count, int width, Array1<uint32> keys_inout) {
    const int y = tid / width, x = tid - y * width;
    const float d = disparity.data[(size_t)y * width + x];
    const int bits = __float_as_int(d), wide = width + 2 * BORDER, high = disparity.shape[0] + 2 * BORDER;
    const unsigned key = bits < 0 ? ~(unsigned)bits : (unsigned)bits | 0x80000000u;
    for (int n = 0; n < count; ++n) {
        // NaN lands nowhere. The shift is split before the column is added: a small number keeps its digits.
        const float shift_x = -d * offsets.data[n].c[0], shift_y = -d * offsets.data[n].c[1];
        const float whole_x = floorf(shift_x), whole_y = floorf(shift_y);
        const float to_x = whole_x + (shift_x - whole_x >= 0.5f ? 1.f : 0.f) + (float)(x + BORDER);
        const float to_y = whole_y + (shift_y - whole_y >= 0.5f ? 1.f : 0.f) + (float)(y + BORDER);
        if (to_x >= 0.f && to_x < (float)wide && to_y >= 0.f && to_y < (float)high)
            atomicMax(keys_inout.data + ((size_t)n * high + (int)to_y) * wide + (int)to_x, key);
    }
}

// The nearest disparity around a pixel of each view; one pixel farther out where nothing is.
void look_around(int tid, Array1<uint32> keys, Array1<vec2f> offsets, int width, Array3<float> nearest_out) {
    const int y = tid / width, x = tid - y * width;
    constexpr int SIDE = 2 * BORDER + 1;
    const int height = nearest_out.shape[1], wide = width + SIDE - 1;
    for (int n = 0; n < nearest_out.shape[0]; ++n) {
        if (isnan(offsets.data[n].c[0])) continue;
        const unsigned* const front = keys.data + ((size_t)n * (height + SIDE - 1) + y) * wide + x;
        unsigned key = 0u;
        #pragma unroll
        for (int j = 1; j < SIDE - 1; ++j)
            #pragma unroll
            for (int i = 1; i < SIDE - 1; ++i) key = max(key, front[j * wide + i]);
        if (key == 0u)
            for (int j = 0; j < SIDE; ++j)
                for (int i = 0; i < SIDE; ++i) key = max(key, front[j * wide + i]);
        const float found = __int_as_float((int)(key >> 31 ? key & 0x7fffffffu : ~key));
        nearest_out.data[((size_t)n * height + y) * width + x] = key ? found : NOWHERE;
    }
}
