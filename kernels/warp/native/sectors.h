// Costs by angular sector on a CPU.
//
// A thread computes some folded rows, in chunks of columns that stay in its cache. Where all pixels of a chunk have the
// same disparity, rows of a view are read as they lie in memory; elsewhere each pixel looks up its own place.
#pragma once
#include "exponential.h"

// Compute the folded rows [y, l] from `first` to before `last`, y from `top` on. The places and numbers of views are in
// the order of sectors, of which s begins at begins[s].
void find_sector_costs(
    Array4<Kept> views, Array2<Pixel> image, Array3<float> valid, Array1<int> order, Array1<int> begins,
    Array1<vec2f> offsets, Array2<float> start, Array1<double> factor, float scale, float step, int top, int first,
    int last, Array3<Costs> costs_out) {
    constexpr int COSTS = 2 * SECTORS, ALL = FOLD * FOLD * COSTS;
    const int height = image.shape[0], width = image.shape[1];
    const int labels = costs_out.shape[0], rows = costs_out.shape[1], columns = costs_out.shape[2];
    const float gain = (float)factor.data[0], stored_gain = gain * scale;
    const int long_row = views.shape[3];
    const size_t plane = (size_t)height * long_row;
    STORED* const to = (STORED*)costs_out.data;
    float disparity[CHUNK], reference[CHANNELS][CHUNK], single[CHUNK], common[CHANNELS][CHUNK], count[CHUNK];
    float costs[COSTS][CHUNK], sums[2][CHUNK], sectors[CHUNK];
    STORED kept[COSTS][FOLD][CHUNK];
    bool there[SECTORS][CHUNK];
    auto size_of = [](float a) { return __builtin_fabsf(a); };
    auto cost_of = [&](float difference) { return 0.25f * log_of(1.f + difference * (1.f / UNIT)); };

    // Add the differences of view n at the columns from x on, all of the disparity d.
    auto add_row = [&](int n, auto offset, float d, int x, int y, int there) {
        const float right = -d * offset[0], down = -d * offset[1];
        const int dx = (int)__builtin_floorf(right), dy = (int)__builtin_floorf(down);
        const float ax = right - dx, ay = down - dy;
        const int next = ax > 0.f, below = ay > 0.f;
        const int begin = x + dx < 0 ? -(x + dx) : 0, room = width - next - x - dx, end = room < there ? room : there;
        if (y + dy < 0 || y + dy + below >= height || begin >= end) return;
        const auto* const upper = views.data + ((size_t)n * CHANNELS * height + y + dy) * long_row + x + dx;
        const auto* const lower = upper + (below ? long_row : 0);
        const float* const counts =
            valid.data ? valid.data + ((size_t)n * height + y + dy + (ay >= 0.5f)) * width + x + dx + (ax >= 0.5f)
                       : nullptr;
        auto add = [&](auto is_counted) {
            #pragma clang loop vectorize(assume_safety)
            for (int j = begin; j < end; ++j) {
                const bool counted = is_counted(j);
                float size = 0.f;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    const float a = upper[c * plane + j], b = lower[c * plane + j];
                    const float high = a + ax * ((float)upper[c * plane + j + next] - a);
                    const float low = b + ax * ((float)lower[c * plane + j + next] - b);
                    const float value = stored_gain * (high + ay * (low - high)) - reference[c][j];
                    const float difference = counted ? value : 0.f;
                    size += size_of(difference);
                    common[c][j] += difference;
                }
                single[j] += size;
                count[j] += counted ? 1.f : 0.f;
            }
        };
        if (counts)
            add([&](int j) { return counts[j] != 0.f; });
        else
            add([](int) { return true; });
    };

    // The same of pixels that have disparities of their own.
    auto add_pixels = [&](int n, auto offset, int x, int y, int there) {
        const auto* const view = views.data + n * CHANNELS * plane;
        const float* const counts = valid.data ? valid.data + (size_t)n * height * width : nullptr;
        // Two neighbours of a row; of bytes and words they are read at once.
        auto look_up = [](const auto* place, float& first, float& second) {
            if constexpr (sizeof(*place) < sizeof(int)) {
                unsigned both;
                __builtin_memcpy(&both, place, sizeof(both));
                constexpr int bits = 8 * sizeof(*place), mask = (1 << bits) - 1;
                first = (int)(both & mask);
                second = (int)(both >> bits & mask);
            } else {
                first = place[0];
                second = place[1];
            }
        };
        auto add = [&](auto is_counted) {
            #pragma clang loop vectorize(assume_safety)
            for (int j = 0; j < there; ++j) {
                const float right = -disparity[j] * offset[0], down = -disparity[j] * offset[1];
                const float whole_x = __builtin_floorf(right), whole_y = __builtin_floorf(down);
                const float ax = right - whole_x, ay = down - whole_y, tx = x + j + whole_x, ty = y + whole_y;
                const bool inside = (tx >= 0.f) & (tx + (ax > 0.f ? 1.f : 0.f) <= width - 1) & (ty >= 0.f)
                    & (ty + (ay > 0.f ? 1.f : 0.f) <= height - 1);
                const int column = inside ? (int)tx : 0, line = inside ? (int)ty : 0;
                const int near = (line + (ay >= 0.5f)) * width + column + (ax >= 0.5f);
                const bool counted = inside & is_counted(inside ? near : 0);
                const int upper = line * long_row + column, lower = upper + ((inside & (ay > 0.f)) ? long_row : 0);
                float size = 0.f;
                #pragma unroll
                for (int c = 0; c < CHANNELS; ++c) {
                    float a, b, d, e;
                    look_up(view + c * plane + upper, a, b);
                    look_up(view + c * plane + lower, d, e);
                    const float high = ax > 0.f ? a + ax * (b - a) : a, low = ax > 0.f ? d + ax * (e - d) : d;
                    const float value = stored_gain * (high + ay * (low - high)) - reference[c][j];
                    const float difference = counted ? value : 0.f;
                    size += size_of(difference);
                    common[c][j] += difference;
                }
                single[j] += size;
                count[j] += counted ? 1.f : 0.f;
            }
        };
        if (counts)
            add([&](int near) { return counts[near] != 0.f; });
        else
            add([](int) { return true; });
    };

    // Compute the costs of a chunk of a row, the i-th of those that are folded into one.
    auto find_costs = [&](int l, int i, int x, int y, int pixels) {
        bool alike = true;
        for (int j = 0; j < pixels; ++j) {
            disparity[j] = start.data[(size_t)y * width + x + j] + (float)l * step;
            alike = alike && disparity[j] == disparity[0];
            for (int c = 0; c < CHANNELS; ++c)
                reference[c][j] = gain * image.data[(size_t)y * width + x + j].c[c];
        }
        for (int j = 0; j < CHUNK; ++j) sums[0][j] = sums[1][j] = sectors[j] = 0.f;
        for (int s = 0; s < SECTORS; ++s) {
            for (int j = 0; j < CHUNK; ++j) single[j] = count[j] = 0.f;
            for (int c = 0; c < CHANNELS; ++c)
                for (int j = 0; j < CHUNK; ++j) common[c][j] = 0.f;
            for (int k = begins.data[s]; k < begins.data[s + 1]; ++k) {
                if (alike)
                    add_row(order.data[k], offsets.data[k], disparity[0], x, y, pixels);
                else
                    add_pixels(order.data[k], offsets.data[k], x, y, pixels);
            }
            #pragma clang loop vectorize(assume_safety)
            for (int j = 0; j < CHUNK; ++j) {
                float sum = 0.f;
                for (int c = 0; c < CHANNELS; ++c) sum += size_of(common[c][j]);
                const float share = 1.f / (CHANNELS * (count[j] > 0.f ? count[j] : 1.f));
                costs[s][j] = cost_of(single[j] * share);
                costs[SECTORS + s][j] = cost_of(sum * share);
                there[s][j] = count[j] > 0.f;
                sums[0][j] += costs[s][j];  // 0 where no view takes part
                sums[1][j] += costs[SECTORS + s][j];
                sectors[j] += there[s][j] ? 1.f : 0.f;
            }
        }
        for (int j = 0; j < CHUNK; ++j)
            for (int i = 0; i < 2; ++i) sums[i][j] = sectors[j] > 0.f ? sums[i][j] / sectors[j] : 1.f;
        for (int c = 0; c < COSTS; ++c) {
            for (int j = 0; j < CHUNK; ++j)
                kept[c][i][j] = (STORED)(there[c % SECTORS][j] ? costs[c][j] : sums[c / SECTORS][j]);
            for (int j = pixels; j < CHUNK; ++j) kept[c][i][j] = kept[c][i][pixels - 1];
        }
    };

    for (int row = first; row < last; ++row) {
        const int l = row % labels, folded_y = top + row / labels;  // all disparities see about the same pixels
        for (int left = 0; left < FOLD * columns; left += CHUNK) {
            const int x = left < width ? left : width - 1, pixels = width - x < CHUNK ? width - x : CHUNK;
            for (int i = 0; i < FOLD; ++i) {
                const int y = FOLD * folded_y + i;
                find_costs(l, i, x, y < height ? y : height - 1, pixels);
            }
            const int some = columns - left / FOLD < CHUNK / FOLD ? columns - left / FOLD : CHUNK / FOLD;
            STORED* const out = to + (((size_t)l * rows + folded_y % rows) * columns + left / FOLD) * ALL;
            for (int j = 0; j < some; ++j)
                #pragma unroll
                for (int c = 0; c < COSTS * FOLD; ++c)
                    __builtin_memcpy(out + j * ALL + c * FOLD, kept[0][c] + j * FOLD, FOLD * sizeof(STORED));
        }
    }
}
