"""A row of the alignment on a CPU; `kernels/reference/alignment.py` says what it is.

A thread goes along the row in chunks, view by view, with their sums on its stack. Vector units have a pixel in each
lane: pixels of a chunk land anywhere, and what they land on is gathered, a pixel with all its channels at once.
"""

ALIGN_ROW = """
    constexpr int CHUNK = 128;
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
    };
    auto is_reference = [&](int n) {
        const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
        return du * du + dv * dv <= NEAR * NEAR;
    };

    for (int begin = 0; begin < width; begin += CHUNK) {
        const int many = wp::min(CHUNK, width - begin);
        float mean[CHANNELS][CHUNK], mean_x[CHANNELS][CHUNK], mean_y[CHANNELS][CHUNK];
        float sum[CHANNELS][CHUNK], sum_x[CHANNELS][CHUNK], sum_y[CHANNELS][CHUNK];
        float sum_k[CHUNK], curvatures[CHUNK], slopes[CHUNK];
        for (int i = 0; i < many; ++i) {
            const int x = begin + i;
            for (int c = 0; c < CHANNELS; ++c) {
                sum[c][i] = mean[c][i] = color_at(y, x, c);
                sum_x[c][i] = mean_x[c][i] = (color_at(y, x + 1, c) - color_at(y, x - 1, c)) * (0.5f * weight);
                sum_y[c][i] = mean_y[c][i] = (color_at(y + 1, x, c) - color_at(y - 1, x, c)) * (0.5f * weight);
            }
            sum_k[i] = 1.f;
            curvatures[i] = slopes[i] = 0.f;
        }
        for (int n = 0; n < count; ++n) {
            if (is_reference(n)) continue;
            land(n, begin, many);
            const Word* const row1 = recorded + n * size;
            const Word* const row0 = row1 - wide;
            const Word* const row2 = row1 + wide;
            const Word* const row3 = row2 + wide;
            #pragma clang loop vectorize(assume_safety)
            for (int i = 0; i < many; ++i) {
                const int p = corners[i];
                const float ax = axs[i], ay = ays[i], bx = 1.f - ax, by = 1.f - ay;
                float f[CHANNELS], fx[CHANNELS], fy[CHANNELS], apart = 0.f;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    auto at = [&](const Word* row, int x) { return channel(row + x, p, c); };
                    auto mean_of = [&](const Word* row) { return at(row, 0) * bx + at(row, 1) * ax; };
                    auto slope_of = [&](const Word* row) {
                        return (at(row, 1) - at(row, -1)) * bx + (at(row, 2) - at(row, 0)) * ax;
                    };
                    const float m0 = mean_of(row0), m1 = mean_of(row1), m2 = mean_of(row2), m3 = mean_of(row3);
                    const float s1 = slope_of(row1), s2 = slope_of(row2);
                    f[c] = (m1 * by + m2 * ay) * scale;
                    fx[c] = (s1 * by + s2 * ay) * (0.5f * scale * weight);
                    fy[c] = ((m2 - m0) * by + (m3 - m1) * ay) * (0.5f * scale * weight);
                    const float r = f[c] - mean[c][i], rx = fx[c] - mean_x[c][i], ry = fy[c] - mean_y[c][i];
                    apart += r * r + rx * rx + ry * ry;
                }
                const float excess = 1.f + apart * weaken, k = parts[i] / (excess * excess);
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    sum[c][i] += f[c] * k;
                    sum_x[c][i] += fx[c] * k;
                    sum_y[c][i] += fy[c] * k;
                }
                sum_k[i] += k;
            }
        }
        for (int i = 0; i < many; ++i) {
            const float share = 1.f / sum_k[i];
            for (int c = 0; c < CHANNELS; ++c) {
                mean[c][i] = sum[c][i] * share;
                mean_x[c][i] = sum_x[c][i] * share;
                mean_y[c][i] = sum_y[c][i] * share;
            }
        }
        for (int n = 0; n < count; ++n) {
            if (is_reference(n)) continue;
            const float du = offsets.data[n].c[0], dv = offsets.data[n].c[1];
            land(n, begin, many);
            const Word* const row2 = recorded + n * size;
            const Word* const row1 = row2 - wide;
            const Word* const row0 = row1 - wide;
            const Word* const row3 = row2 + wide;
            const Word* const row4 = row3 + wide;
            const Word* const row5 = row4 + wide;
            #pragma clang loop vectorize(assume_safety)
            for (int i = 0; i < many; ++i) {
                const int p = corners[i];
                const float ax = axs[i], ay = ays[i], bx = 1.f - ax, by = 1.f - ay;
                float apart = 0.f, bend = 0.f, climb = 0.f;
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
                    const float f = (m2 * by + m3 * ay) * scale;
                    const float fx = (s2 * by + s3 * ay) * (0.5f * scale);
                    const float fy = ((m3 - m1) * by + (m4 - m2) * ay) * (0.5f * scale);
                    const float fxx = (t2 * by + t3 * ay) * (0.25f * scale);
                    const float fxy = ((s3 - s1) * by + (s4 - s2) * ay) * (0.25f * scale);
                    const float fyy = ((m0 + m4 - m2 * 2.f) * by + (m1 + m5 - m3 * 2.f) * ay) * (0.25f * scale);
                    const float r = f - mean[c][i], rx = fx * weight - mean_x[c][i], ry = fy * weight - mean_y[c][i];
                    apart += r * r + rx * rx + ry * ry;
                    // Against the derivatives by d, so that their product with the residuals is what the slope adds up.
                    const float g = fx * du + fy * dv;
                    const float gx = (fxx * du + fxy * dv) * weight, gy = (fxy * du + fyy * dv) * weight;
                    bend += g * g + gx * gx + gy * gy;
                    climb += g * r + gx * rx + gy * ry;
                }
                const float excess = 1.f + apart * weaken, k = parts[i] / (excess * excess);
                curvatures[i] += k * bend;
                slopes[i] += k * climb;
            }
        }
        for (int i = 0; i < many; ++i) {
            curvature.data[(size_t)y * width + begin + i] = curvatures[i] * share_of_all;
            slope.data[(size_t)y * width + begin + i] = slopes[i] * share_of_all;
        }
    }
"""
