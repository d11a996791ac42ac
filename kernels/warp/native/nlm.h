// Weights and sums of non-local means on a CPU, row by row.
#pragma once
#include "lfgpu.h"
#include "exponential.h"
#include "nlm_plane.h"

// Weights of pairs of pixels at the places of a half window from `first` to before `last`.
//
// For one neighbour after the other, a thread goes down the image. It adds up the distances of a row over the patches'
// columns once and keeps the last few rows of these sums.
void weigh_neighbors(
    Array3<float> features, Array1<vec2i> half_window, int radius, float least, int is_mean, int first, int last,
    Array1<float> room, Array3<float> weights_out) {
    const int height = features.shape[1], width = features.shape[2], rows = 2 * radius + 1, wide = width + 2 * radius;
    const size_t plane = (size_t)height * width;
    float* const distances = room.data;                  // [wide]: a row, and 0 beside it
    float* const counts = distances + wide;              // [width]: columns that patches have there
    float* const sums = counts + width;                  // [rows, width]: row y in ring place y % rows
    for (int k = first; k < last; ++k) {
        const int dy = half_window.data[k].c[0], dx = half_window.data[k].c[1];
        const int begin = dx < 0 ? -dx : 0, end = dx < 0 ? width : width - dx, high = height - dy;
        for (int x = begin; x < end; ++x) {
            const int left = x - radius > begin ? x - radius : begin;
            const int right = x + radius < end - 1 ? x + radius : end - 1;
            counts[x] = (float)(right - left + 1);
        }
        for (int x = 0; x < wide; ++x) distances[x] = 0.f;
        float* const out = weights_out.data + k * plane;
        int done = 0;
        for (int y = 0; y < height; ++y) {
            float* const row = out + (size_t)y * width;
            for (int x = 0; x < width; ++x) row[x] = 0.f;
            const int top = y - radius > 0 ? y - radius : 0, bottom = y + radius < high - 1 ? y + radius : high - 1;
            for (; done <= bottom; ++done) {
                const float* const here = features.data + (size_t)done * width;
                const float* const there = here + (long long)dy * width + dx;
                float* const distance = distances + radius;
                #pragma clang loop vectorize(assume_safety)
                for (int x = begin; x < end; ++x) {
                    float sum = 0.f;
                    #pragma unroll
                    for (int c = 0; c < FEATURES; ++c) {
                        const float difference = here[c * plane + x] - there[c * plane + x];
                        sum += difference * difference;
                    }
                    distance[x] = sum;
                }
                float* const sum = sums + (size_t)(done % rows) * width;
                for (int x = begin; x < end; ++x) sum[x] = distances[x];
                for (int i = 1; i < rows; ++i)
                    #pragma clang loop vectorize(assume_safety)
                    for (int x = begin; x < end; ++x) sum[x] += distances[x + i];
            }
            if (y >= high) continue;
            for (int r = top; r <= bottom; ++r) {
                const float* const sum = sums + (size_t)(r % rows) * width;
                #pragma clang loop vectorize(assume_safety)
                for (int x = begin; x < end; ++x) row[x] += sum[x];
            }
            const float tall = (float)(bottom - top + 1);
            #pragma clang loop vectorize(assume_safety)
            for (int x = begin; x < end; ++x) {
                const float weight = exp_of(is_mean ? -row[x] / (tall * counts[x]) : -row[x]);
                row[x] = weight > least ? weight : least;
            }
        }
    }
}

// Call add(weights, first, last, other, dx, dy) for all neighbours of the pixels of a row from `begin` to `end`.
//
// The pixels from `first` to before `last` have the neighbour; that of pixel x lies at other + x.
inline void for_neighbors(const auto& weights, const auto& steps, int y, int begin, int end, auto add) {
    const int height = weights.shape[1], width = weights.shape[2], size = height * width, row = y * width;
    for (int k = 0; k < steps.shape[0]; ++k)
        for (int sign = 1; sign >= -1; sign -= 2) {
            const int dy = sign * steps.data[k].c[0], dx = sign * steps.data[k].c[1];
            if ((unsigned)(y + dy) >= (unsigned)height) continue;
            const int first = wp::max(begin, -dx), last = wp::min(end, width - dx), other = row + dy * width + dx;
            // Of a pair the second pixel finds the weight at the first.
            add(weights.data + (size_t)k * size + (sign > 0 ? row : other), first, last, other, dx, dy);
        }
}

// Add up TERM over the neighbours of each pixel of a row.
//
// The loop over the window is the outer one: what a row adds up stays in cache, and weights are read in the order in
// which they lie.
void add_neighbors(
    int tid, Array3<float> weights, Array2<float> values, Array2<float> diagonal, Array1<vec2i> half_window, int line,
    int lanes, Array2<float> sums_out) {
    const int width = weights.shape[2], row = (line + tid) * width;
    const float* __restrict__ const v = values.data;
    float* __restrict__ const sums = sums_out.data + row;
    for (int x = 0; x < width; ++x)
        sums[x] = (diagonal.data ? KEEP + diagonal.data[row + x] : KEEP) * v[row + x];
    auto add = [&](const float* __restrict__ w, int first, int last, int neighbor, int, int) {
        for (int x = first; x < last; ++x) {
            const float here = v[row + x], other = v[neighbor + x];
            sums[x] += w[x] * TERM;
        }
    };
    for_neighbors(weights, half_window, line + tid, 0, width, add);
}

// A ratio of sums whose weights also depend on a guide; a row goes in chunks, whose sums lie on the stack.
void divide_sums(
    int tid, Array3<float> weights, Array2<float> guide, Array2<float> numerator, Array2<float> denominator,
    Array1<vec2i> half_window, float support, Number floor, int line, int lanes, Array2<float> ratio_out) {
    constexpr int CHUNK = 128;
    const int width = weights.shape[2], y = line + tid, row = y * width;
    const float weaken = 1.f / (support * support);
    const float* __restrict__ const g = guide.data;
    const float* __restrict__ const a = numerator.data;
    const float* __restrict__ const b = denominator.data;
    for (int begin = 0; begin < width; begin += CHUNK) {
        const int end = wp::min(begin + CHUNK, width);
        float above[CHUNK], below[CHUNK];
        for (int x = begin; x < end; ++x) {
            above[x - begin] = a[row + x];
            below[x - begin] = b[row + x] + floor;
        }
        auto add = [&](const float* __restrict__ w, int first, int last, int other, int, int) {
            for (int x = first; x < last; ++x) {
                const float apart = g[other + x] - g[row + x], v = w[x] / (1.f + apart * apart * weaken);
                above[x - begin] += v * a[other + x];
                below[x - begin] += v * (b[other + x] + floor);
            }
        };
        for_neighbors(weights, half_window, y, begin, end, add);
        for (int x = begin; x < end; ++x) ratio_out.data[row + x] = above[x - begin] / below[x - begin];
    }
}

// The plane through a map around each pixel of a row.
void fit_planes(
    int tid, Array3<float> weights, Array2<float> values, Array2<float> certainty, Array1<vec2i> half_window,
    float support, float ridge, int line, int lanes, Array2<float> plane_out) {
    constexpr int CHUNK = 128;
    const int width = weights.shape[2], y = line + tid, row = y * width;
    const float weaken = 1.f / (support * support);
    const float* __restrict__ const d = values.data;
    const float* __restrict__ const c = certainty.data;
    for (int begin = 0; begin < width; begin += CHUNK) {
        const int end = wp::min(begin + CHUNK, width);
        float total[CHUNK], sx[CHUNK], sy[CHUNK], sxx[CHUNK], sxy[CHUNK], syy[CHUNK], sd[CHUNK], sxd[CHUNK], syd[CHUNK];
        for (int j = 0; j < end - begin; ++j) {
            total[j] = c[row + begin + j];
            sx[j] = sy[j] = sxx[j] = sxy[j] = syy[j] = sd[j] = sxd[j] = syd[j] = 0.f;
        }
        auto add = [&](const float* __restrict__ w, int first, int last, int other, int dx, int dy) {
            const float fx = (float)dx, fy = (float)dy;
            #pragma clang loop vectorize(assume_safety)
            for (int x = first; x < last; ++x) {
                const int j = x - begin;
                const float apart = d[other + x] - d[row + x];
                const float u = w[x] * c[other + x] / (1.f + apart * apart * weaken), ud = u * apart;
                total[j] += u;
                sx[j] += fx * u;
                sy[j] += fy * u;
                sxx[j] += fx * fx * u;
                sxy[j] += fx * fy * u;
                syy[j] += fy * fy * u;
                sd[j] += ud;
                sxd[j] += fx * ud;
                syd[j] += fy * ud;
            }
        };
        for_neighbors(weights, half_window, y, begin, end, add);
        for (int j = 0; j < end - begin; ++j) {
            const float sums[9] = {total[j], sx[j], sy[j], sxx[j], sxy[j], syy[j], sd[j], sxd[j], syd[j]};
            plane_out.data[row + begin + j] = plane_at(d[row + begin + j], sums, ridge);
        }
    }
}
