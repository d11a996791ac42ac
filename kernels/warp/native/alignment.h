// The alignment on a CPU, of a row and of its views.
//
// A thread goes along the row in chunks, view by view, with their sums on its stack. Vector units have a pixel in each
// lane: where pixels of a chunk land in line, what they land on is read as it lies, elsewhere it is gathered, a pixel
// with all its channels at once.
#pragma once
#include "lfgpu.h"

// Curvature and slope of the squared differences of a row.
void align(
    int tid, Array2<Pixel> image, Array2<float> weights, Array3<Kept> views, Array1<vec2f> offsets, float scale,
    Number robust, float tolerance, float share_of_all, Array2<float> disparity, Array3<float> nearest, int line,
    int lanes, Array2<float> curvature_out, Array2<float> slope_out) {
    const int y = line + tid / lanes;
    constexpr int CHUNK = 128, RUN = 16;
    const int height = disparity.shape[0], width = disparity.shape[1], count = offsets.shape[0];
    const int wide = width + BORDER;
    const size_t size = (size_t)(height + BORDER) * wide;
    const float weaken = 1.f / (3 * CHANNELS * robust * robust);

    // Channel c of a pixel of the copies.
    typedef WORD Word;
    const Word* const recorded = (const Word*)views.data;
    auto channel = [](const auto* pixels, int at, int c) {
        if constexpr (IS_FLOAT) return pixels[at].c[c];
        else return (float)(int)((pixels[at] >> c * BITS) & ((1u << BITS) - 1u));
    };
    auto color_at = [&](int row, int column, int c) {
        const int p = wp::min(wp::max(row, 0), height - 1) * width + wp::min(wp::max(column, 0), width - 1);
        return image.data[p].c[c];
    };

    // Where a chunk of pixels lands in a view, as the first of four taps, and whether the view takes part there.
    int corners[CHUNK];
    bool in_line[CHUNK / RUN];
    float axs[CHUNK], ays[CHUNK], parts[CHUNK];
    auto land = [&](int n, int begin, int many) {
        const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
        const float* const ds = disparity.data + (size_t)y * width + begin;
        const float* const front = nearest.data + (size_t)n * height * width;
        const Word* const view = recorded + n * size;
        #pragma clang loop vectorize(assume_safety)
        for (int i = 0; i < many; ++i) {
            // The shift is split before the column is added: a small number keeps its digits.
            const float shift_x = -ds[i] * du, shift_y = -ds[i] * dv;
            const float whole_x = floorf(shift_x), whole_y = floorf(shift_y);
            const float column = (float)(begin + i) + whole_x, row = (float)y + whole_y;
            const float ax = shift_x - whole_x, ay = shift_y - whole_y;
            const bool inside = (column >= 0.f) & (column + (ax > 0.f ? 1.f : 0.f) <= (float)(width - 1))
                & (row >= 0.f) & (row + (ay > 0.f ? 1.f : 0.f) <= (float)(height - 1));
            axs[i] = ax;
            ays[i] = ay;
            const int x0 = inside ? (int)column : 0, y0 = inside ? (int)row : 0;  // what does not take part reads, too
            const int x1 = x0 + (inside & (ax >= 0.5f)), y1 = y0 + (inside & (ay >= 0.5f));
            corners[i] = (y0 + BEFORE) * wide + x0 + BEFORE;
            const bool seen = ds[i] >= front[y1 * width + x1] - tolerance;
            const bool valid = channel(view, (y1 + BEFORE) * wide + x1 + BEFORE, PAD - 1) != 0.f;
            parts[i] = (inside & seen & valid) ? 1.f : 0.f;
        }
        for (int run = 0; run + RUN <= many; run += RUN) {
            int apart = 0;
            for (int i = 0; i < RUN; ++i) apart |= corners[run + i] - corners[run] - i;
            in_line[run / RUN] = apart == 0;
        }
    };
    // work(pixel of the chunk, its corner): most runs of pixels land in line, and what they land on is read at once.
    auto for_each = [&](int many, auto work) {
        int run = 0;
        for (; run + RUN <= many; run += RUN) {
            if (in_line[run / RUN]) {
                const int corner = corners[run];
                #pragma clang loop vectorize(assume_safety)
                for (int i = 0; i < RUN; ++i) work(run + i, corner + i);
            } else {
                #pragma clang loop vectorize(assume_safety)
                for (int i = 0; i < RUN; ++i) work(run + i, corners[run + i]);
            }
        }
        #pragma clang loop vectorize(assume_safety)
        for (int i = run; i < many; ++i) work(i, corners[i]);
    };
    auto is_left_out = [&](int n) {  // the reference, or NaN
        const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
        return !(du * du + dv * dv > NEAR * NEAR);
    };

    for (int begin = 0; begin < width; begin += CHUNK) {
        const int many = wp::min(CHUNK, width - begin);
        const float* const weight = weights.data + (size_t)y * width + begin;
        // Intensities and their differences: the first mean of those who see a pixel, then what they are apart from it.
        float own[3][CHANNELS][CHUNK], mean[3][CHANNELS][CHUNK], sum_k[CHUNK];
        // Their changes, across and down, from which the derivatives by d are; offsets times residuals, and squared.
        float change[5][CHANNELS][CHUNK], right[3][CHANNELS][CHUNK], below[3][CHANNELS][CHUNK];
        float uu[CHUNK], uv[CHUNK], vv[CHUNK], sum_change[CHUNK];
        for (int i = 0; i < many; ++i) {
            const int x = begin + i;
            for (int c = 0; c < CHANNELS; ++c) {
                auto at = [&](int down, int across) { return color_at(y + down, x + across, c); };
                const float middle = 2.f * at(0, 0);
                own[0][c][i] = mean[0][c][i] = at(0, 0);
                own[1][c][i] = mean[1][c][i] = change[0][c][i] = (at(0, 1) - at(0, -1)) * 0.5f;
                own[2][c][i] = mean[2][c][i] = change[1][c][i] = (at(1, 0) - at(-1, 0)) * 0.5f;
                change[2][c][i] = (at(0, 2) + at(0, -2) - middle) * 0.25f;
                change[3][c][i] = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) * 0.25f;
                change[4][c][i] = (at(2, 0) + at(-2, 0) - middle) * 0.25f;
                for (int j = 0; j < 3; ++j) right[j][c][i] = below[j][c][i] = 0.f;
            }
            sum_k[i] = sum_change[i] = 1.f;
            uu[i] = uv[i] = vv[i] = 0.f;
        }
        for (int n = 0; n < count; ++n) {
            if (is_left_out(n)) continue;
            land(n, begin, many);
            const Word* const row1 = recorded + n * size;
            const Word* const row0 = row1 - wide;
            const Word* const row2 = row1 + wide;
            const Word* const row3 = row2 + wide;
            for_each(many, [&](int i, int p) {
                const float ax = axs[i], ay = ays[i], bx = 1.f - ax, by = 1.f - ay, w = weight[i];
                float found[3][CHANNELS], apart = 0.f;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    auto at = [&](const Word* row, int x) { return channel(row + x, p, c); };
                    auto mean_of = [&](const Word* row) { return at(row, 0) * bx + at(row, 1) * ax; };
                    auto slope_of = [&](const Word* row) {
                        return (at(row, 1) - at(row, -1)) * bx + (at(row, 2) - at(row, 0)) * ax;
                    };
                    const float m0 = mean_of(row0), m1 = mean_of(row1), m2 = mean_of(row2), m3 = mean_of(row3);
                    const float s1 = slope_of(row1), s2 = slope_of(row2);
                    found[0][c] = (m1 * by + m2 * ay) * scale;
                    found[1][c] = (s1 * by + s2 * ay) * (0.5f * scale);
                    found[2][c] = ((m2 - m0) * by + (m3 - m1) * ay) * (0.5f * scale);
                    const float r = found[0][c] - own[0][c][i];
                    const float rx = (found[1][c] - own[1][c][i]) * w, ry = (found[2][c] - own[2][c][i]) * w;
                    apart += r * r + rx * rx + ry * ry;
                }
                const float excess = 1.f + apart * weaken, k = parts[i] / (excess * excess);
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c)
                    #pragma unroll
                    for (int j = 0; j < 3; ++j) mean[j][c][i] += found[j][c] * k;
                sum_k[i] += k;
            });
        }
        for (int i = 0; i < many; ++i)
            for (int j = 0; j < 3; ++j)
                for (int c = 0; c < CHANNELS; ++c) mean[j][c][i] /= sum_k[i];
        for (int n = 0; n < count; ++n) {
            if (is_left_out(n)) continue;
            const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
            land(n, begin, many);
            const Word* const row2 = recorded + n * size;
            const Word* const row1 = row2 - wide;
            const Word* const row0 = row1 - wide;
            const Word* const row3 = row2 + wide;
            const Word* const row4 = row3 + wide;
            const Word* const row5 = row4 + wide;
            for_each(many, [&](int i, int p) {
                const float ax = axs[i], ay = ays[i], bx = 1.f - ax, by = 1.f - ay, w = weight[i];
                float residual[3][CHANNELS], found[5][CHANNELS], apart = 0.f;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    // Along a row the mean m, twice its difference s, and four times the second one t; rows 0 to 5.
                    auto at = [&](const Word* row, int x) { return channel(row + x, p, c); };
                    auto m_of = [&](const Word* row) { return at(row, 0) * bx + at(row, 1) * ax; };
                    auto s_of = [&](const Word* row) {
                        return (at(row, 1) - at(row, -1)) * bx + (at(row, 2) - at(row, 0)) * ax;
                    };
                    auto t_of = [&](const Word* row, float m) {
                        return at(row, -2) * bx + at(row, -1) * ax + at(row, 2) * bx + at(row, 3) * ax - m * 2.f;
                    };
                    const float m0 = m_of(row0), m1 = m_of(row1), m2 = m_of(row2);
                    const float m3 = m_of(row3), m4 = m_of(row4), m5 = m_of(row5);
                    const float s1 = s_of(row1), s2 = s_of(row2), s3 = s_of(row3), s4 = s_of(row4);
                    const float t2 = t_of(row2, m2), t3 = t_of(row3, m3);
                    found[0][c] = (s2 * by + s3 * ay) * (0.5f * scale);
                    found[1][c] = ((m3 - m1) * by + (m4 - m2) * ay) * (0.5f * scale);
                    found[2][c] = (t2 * by + t3 * ay) * (0.25f * scale);
                    found[3][c] = ((s3 - s1) * by + (s4 - s2) * ay) * (0.25f * scale);
                    found[4][c] = ((m0 + m4 - m2 * 2.f) * by + (m1 + m5 - m3 * 2.f) * ay) * (0.25f * scale);
                    const float r = (m2 * by + m3 * ay) * scale - mean[0][c][i];
                    const float rx = (found[0][c] - mean[1][c][i]) * w, ry = (found[1][c] - mean[2][c][i]) * w;
                    apart += r * r + rx * rx + ry * ry;
                    residual[0][c] = r;
                    residual[1][c] = rx;
                    residual[2][c] = ry;
                }
                const float excess = 1.f + apart * weaken, k = parts[i] / (excess * excess), ku = k * du, kv = k * dv;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    #pragma unroll
                    for (int j = 0; j < 5; ++j) change[j][c][i] += found[j][c] * k;
                    #pragma unroll
                    for (int j = 0; j < 3; ++j) {
                        right[j][c][i] += residual[j][c] * ku;
                        below[j][c][i] += residual[j][c] * kv;
                    }
                }
                uu[i] += ku * du;
                uv[i] += ku * dv;
                vv[i] += kv * dv;
                sum_change[i] += k;
            });
        }
        for (int i = 0; i < many; ++i) {
            const float share = 1.f / sum_change[i], of_gradients = share * weight[i];
            float bend = 0.f, climb = 0.f;
            // Against the derivatives by d, so that their product with the residuals is what the slope adds up.
            auto add = [&](int j, int c, float across, float down) {
                bend += across * across * uu[i] + 2.f * across * down * uv[i] + down * down * vv[i];
                climb += across * right[j][c][i] + down * below[j][c][i];
            };
            for (int c = 0; c < CHANNELS; ++c) {
                add(0, c, change[0][c][i] * share, change[1][c][i] * share);
                add(1, c, change[2][c][i] * of_gradients, change[3][c][i] * of_gradients);
                add(2, c, change[3][c][i] * of_gradients, change[4][c][i] * of_gradients);
            }
            curvature_out.data[(size_t)y * width + begin + i] = bend * share_of_all;
            slope_out.data[(size_t)y * width + begin + i] = climb * share_of_all;
        }
    }
}

// Copy a row of all views, a pixel with whether it is valid; the copies go on as at the border of the views.
void pack(int tid, Array3<Stored> recorded, Array3<float> valid, int row, int lanes, Array3<Kept> packed_out) {
    const int y = row + tid;
    const int height = recorded.shape[1], width = recorded.shape[2], wide = width + BORDER;
    const int from_y = wp::min(wp::max(y - BEFORE, 0), height - 1);
    for (int n = 0; n < recorded.shape[0]; ++n) {
        const auto* const line = recorded.data + ((size_t)n * height + from_y) * width;
        const float* const mask = valid.data + ((size_t)n * height + from_y) * width;
        auto* const out = packed_out.data + ((size_t)n * (height + BORDER) + y) * wide;
        auto pack = [&](int x, int from_x, KEPT is_valid) {
            for (int c = 0; c < CHANNELS; ++c) out[x].c[c] = (KEPT)line[from_x].c[c];
            for (int c = CHANNELS; c < PAD - 1; ++c) out[x].c[c] = 0;
            out[x].c[PAD - 1] = is_valid;
        };
        if (valid.data) {
            #pragma clang loop vectorize(assume_safety)
            for (int x = 0; x < width; ++x) pack(x + BEFORE, x, mask[x] != 0.f);
        } else {
            #pragma clang loop vectorize(assume_safety)
            for (int x = 0; x < width; ++x) pack(x + BEFORE, x, 1);
        }
        for (int x = 0; x < BEFORE; ++x) out[x] = out[BEFORE];
        for (int x = width + BEFORE; x < wide; ++x) out[x] = out[width + BEFORE - 1];
    }
}
