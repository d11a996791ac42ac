// The alignment on a GPU, of a pixel and of its views.
//
// A thread has one pixel, and goes through all views twice: first for the mean of those that see it, then for what they
// are apart from that.
#pragma once
#include "lfgpu.h"

// Copy a pixel of all views, with whether it is valid last; the copies go on as at the border of the views.
void pack(int tid, Array3<Stored> recorded, Array3<float> valid, int row, int lanes, Array3<Kept> packed_out) {
    const int y = row + tid / lanes, x = tid % lanes;
    const int height = recorded.shape[1], width = recorded.shape[2], wide = width + BORDER, p = y * wide + x;
    const int from_y = min(max(y - BEFORE, 0), height - 1), from_x = min(max(x - BEFORE, 0), width - 1);
    const size_t from = (size_t)from_y * width + from_x, size = (size_t)height * width;
    #pragma unroll 4
    for (int n = 0; n < recorded.shape[0]; ++n) {
        const auto value = recorded.data[n * size + from];
        auto kept = packed_out.data[0];
        for (int c = 0; c < PAD; ++c) kept.c[c] = 0;
        for (int c = 0; c < CHANNELS; ++c) kept.c[c] = value.c[c];
        if (!valid.data || valid.data[n * size + from] != 0.f) kept.c[PAD - 1] = 1;
        packed_out.data[(size_t)n * (height + BORDER) * wide + p] = kept;
    }
}

// Curvature and slope of the squared differences of a pixel.
void align(
    int tid, Array2<Pixel> image, Array2<float> weights, Array3<Kept> views, Array1<vec2f> offsets, float scale,
    Number robust, float tolerance, float share_of_all, Array2<float> disparity, Array3<float> nearest, int line,
    int lanes, Array2<float> curvature_out, Array2<float> slope_out) {
    const int y = line + tid / lanes, x = tid % lanes;
    struct Value {
        float c[CHANNELS];
        CUDA_CALLABLE float& operator[](int i) { return c[i]; }
        CUDA_CALLABLE Value operator+(const Value& o) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] + o.c[i];
            return r;
        }
        CUDA_CALLABLE Value operator-(const Value& o) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] - o.c[i];
            return r;
        }
        CUDA_CALLABLE Value operator*(const Value& o) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] * o.c[i];
            return r;
        }
        CUDA_CALLABLE Value operator*(float f) const {
            Value r;
            for (int i = 0; i < CHANNELS; ++i) r.c[i] = c[i] * f;
            return r;
        }
    };
    struct alignas(PAD * sizeof(KEPT)) Packed { KEPT c[PAD]; };
    const Packed* const recorded = (const Packed*)views.data;
    const int height = disparity.shape[0], width = disparity.shape[1], count = offsets.shape[0];
    const int wide = width + BORDER;
    const size_t size = (size_t)(height + BORDER) * wide;
    const float weaken = 1.f / (3 * CHANNELS * robust * robust);

    // The stored value and `zero`: differences of two are without it. An integer in the lowest place of the float 2^23
    // adds its value to it: cheaper for a GPU than a conversion. No x is negative; but if the compiler knew these bits,
    // it would move the selectors of bytes through registers instead.
    const unsigned float_2_23 = 0x4b000000u + (x < 0);
    auto value_of = [=](const Packed& kept) {
        const WORDS words = *(const WORDS*)&kept;  // one load
        Value value;
    #if IS_INTEGER
        const unsigned pairs[] = {PAIRS};
        for (int i = 0; i < CHANNELS; ++i) {
            const unsigned place = BITS == 8 ? 0x7440u | i : i % 2 ? 0x7432u : 0x7410u;
            value[i] = __uint_as_float(__byte_perm(pairs[i * BITS / 32], float_2_23, place));
        }
    #else
        const Packed loaded = *(const Packed*)&words;
        for (int i = 0; i < CHANNELS; ++i) value[i] = (float)loaded.c[i];
    #endif
        return value;
    };
    Value zero;
    for (int i = 0; i < CHANNELS; ++i) zero[i] = IS_INTEGER ? 8388608.f : 0.f;
    auto sum_of = [](Value value) {
        float sum = 0.f;
        for (int i = 0; i < CHANNELS; ++i) sum += value[i];
        return sum;
    };
    auto color_at = [&](int row, int column) {
        const int p = wp::min(wp::max(row, 0), height - 1) * width + wp::min(wp::max(column, 0), width - 1);
        Value value = {};
        for (int i = 0; i < CHANNELS; ++i) value[i] = image.data[p].c[i];
        return value;
    };
    const float d = disparity.data[(size_t)y * width + x], w = weights.data[(size_t)y * width + x];

    // What views show where the pixel lands: work(offset, the first of four taps, how far it lies behind that).
    auto for_views = [&](auto work) {
        for (int n = 0; n < count; ++n) {
            const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
            if (!(du * du + dv * dv > NEAR * NEAR)) continue;  // the reference, or NaN
            // The shift is split before the column is added: a small number keeps its digits.
            const float shift_x = -d * du, shift_y = -d * dv, whole_x = floorf(shift_x), whole_y = floorf(shift_y);
            const float column = (float)x + whole_x, row = (float)y + whole_y;
            const float ax = shift_x - whole_x, ay = shift_y - whole_y;
            const bool inside = (column >= 0.f) & (column + (ax > 0.f ? 1.f : 0.f) <= (float)(width - 1))
                & (row >= 0.f) & (row + (ay > 0.f ? 1.f : 0.f) <= (float)(height - 1));
            if (!inside) continue;
            const int next_x = ax >= 0.5f, next_y = ay >= 0.5f, pixel = (int)row * width + (int)column;
            const float front = nearest.data[(size_t)n * height * width + pixel + next_y * width + next_x];
            const Packed* const first = recorded + n * size + ((int)row + BEFORE) * wide + (int)column + BEFORE;
            const bool valid = (float)first[next_y * wide + next_x].c[PAD - 1] != 0.f;
            if ((d >= front - tolerance) & valid) work(du, dv, first, ax, ay);
        }
    };

    // Intensities and their differences: the first mean of those who see a pixel, then what they are apart from it.
    const Value own = color_at(y, x);
    const Value own_x = (color_at(y, x + 1) - color_at(y, x - 1)) * 0.5f;
    const Value own_y = (color_at(y + 1, x) - color_at(y - 1, x)) * 0.5f;
    Value mean = own, mean_x = own_x, mean_y = own_y;
    float sum_k = 1.f;
    for_views([&](float, float, const Packed* first, float ax, float ay) {
        const float bx = 1.f - ax, by = 1.f - ay;
        const Packed* p = first - wide;
        auto mean_of = [&]() {
            const Value here = value_of(p[0]);
            return here - zero + (value_of(p[1]) - here) * ax;
        };
        auto slope_of = [&]() {
            return (value_of(p[1]) - value_of(p[-1])) * bx + (value_of(p[2]) - value_of(p[0])) * ax;
        };
        const Value m0 = mean_of();
        p += wide;
        const Value m1 = mean_of(), s1 = slope_of();
        p += wide;
        const Value m2 = mean_of(), s2 = slope_of();
        p += wide;
        const Value m3 = mean_of();
        const float half = 0.5f * scale, upper = by * half, lower = ay * half;
        const Value f = m1 * (by * scale) + m2 * (ay * scale);
        const Value fx = s1 * upper + s2 * lower;
        const Value fy = (m2 - m0) * upper + (m3 - m1) * lower;
        const Value r = f - own, rx = (fx - own_x) * w, ry = (fy - own_y) * w;
        const float excess = 1.f + sum_of(r * r + rx * rx + ry * ry) * weaken, k = 1.f / (excess * excess);
        mean = mean + f * k;
        mean_x = mean_x + fx * k;
        mean_y = mean_y + fy * k;
        sum_k += k;
    });
    const float share_of_mean = 1.f / sum_k;
    mean = mean * share_of_mean;
    mean_x = mean_x * share_of_mean;
    mean_y = mean_y * share_of_mean;

    // Their changes, across and down, from which the derivatives by d are; offsets times residuals, and squared.
    Value change_x = own_x, change_y = own_y;
    Value change_xx = (color_at(y, x + 2) + color_at(y, x - 2) - own * 2.f) * 0.25f;
    Value change_yy = (color_at(y + 2, x) + color_at(y - 2, x) - own * 2.f) * 0.25f;
    const Value above = color_at(y - 1, x + 1) - color_at(y - 1, x - 1);
    Value change_xy = (color_at(y + 1, x + 1) - color_at(y + 1, x - 1) - above) * 0.25f;
    Value right[3] = {}, below[3] = {};
    float uu = 0.f, uv = 0.f, vv = 0.f, sum_change = 1.f;
    for_views([&](float du, float dv, const Packed* first, float ax, float ay) {
        const float bx = 1.f - ax, by = 1.f - ay;
        // Along a row the mean m, twice its difference s, and four times the second one t; rows 0 to 5.
        const Packed* p = first - 2 * wide;
        auto m_of = [&]() {
            const Value here = value_of(p[0]);
            return here - zero + (value_of(p[1]) - here) * ax;
        };
        auto s_of = [&]() {
            return (value_of(p[1]) - value_of(p[-1])) * bx + (value_of(p[2]) - value_of(p[0])) * ax;
        };
        auto t_of = [&]() {
            const Value here = value_of(p[0]), right = value_of(p[1]);
            return (value_of(p[-2]) - here + (value_of(p[2]) - here)) * bx
                + (value_of(p[-1]) - right + (value_of(p[3]) - right)) * ax;
        };
        const Value m0 = m_of();
        p += wide;
        const Value m1 = m_of(), s1 = s_of();
        p += wide;
        const Value m2 = m_of(), s2 = s_of(), t2 = t_of();
        p += wide;
        const Value m3 = m_of(), s3 = s_of(), t3 = t_of();
        p += wide;
        const Value m4 = m_of(), s4 = s_of();
        p += wide;
        const Value m5 = m_of();
        const float upper = by * scale, upper_half = 0.5f * upper, upper_quarter = 0.25f * upper;
        const float lower = ay * scale, lower_half = 0.5f * lower, lower_quarter = 0.25f * lower;
        const Value f = m2 * upper + m3 * lower;
        const Value fx = s2 * upper_half + s3 * lower_half;
        const Value fy = (m3 - m1) * upper_half + (m4 - m2) * lower_half;
        const Value r = f - mean, rx = (fx - mean_x) * w, ry = (fy - mean_y) * w;
        const float excess = 1.f + sum_of(r * r + rx * rx + ry * ry) * weaken, k = 1.f / (excess * excess);
        change_x = change_x + fx * k;
        change_y = change_y + fy * k;
        change_xx = change_xx + (t2 * upper_quarter + t3 * lower_quarter) * k;
        change_xy = change_xy + ((s3 - s1) * upper_quarter + (s4 - s2) * lower_quarter) * k;
        const Value fyy = (m0 + m4 - m2 * 2.f) * upper_quarter + (m1 + m5 - m3 * 2.f) * lower_quarter;
        change_yy = change_yy + fyy * k;
        const float ku = k * du, kv = k * dv;
        const Value residuals[3] = {r, rx, ry};
        for (int j = 0; j < 3; ++j) {
            right[j] = right[j] + residuals[j] * ku;
            below[j] = below[j] + residuals[j] * kv;
        }
        uu += ku * du;
        uv += ku * dv;
        vv += kv * dv;
        sum_change += k;
    });
    const float share = 1.f / sum_change, of_gradients = share * w;
    float bend = 0.f, climb = 0.f;
    // Against the derivatives by d, so that their product with the residuals is what the slope adds up.
    auto add = [&](int j, Value across, Value down) {
        bend += sum_of(across * across) * uu + 2.f * sum_of(across * down) * uv + sum_of(down * down) * vv;
        climb += sum_of(across * right[j] + down * below[j]);
    };
    add(0, change_x * share, change_y * share);
    add(1, change_xx * of_gradients, change_xy * of_gradients);
    add(2, change_xy * of_gradients, change_yy * of_gradients);
    curvature_out.data[(size_t)y * width + x] = bend * share_of_all;
    slope_out.data[(size_t)y * width + x] = climb * share_of_all;
}
