// Views for comparisons: means of pixels that look alike on a CPU, and reduced views on any device.
#pragma once
#include "lfgpu.h"

// The stored value of an intensity.
inline unsigned short stored(float value) {
    const float inside = value < 0.f ? 0.f : value > 1.f ? 1.f : value;
    return (unsigned short)(WHITE * inside + 0.5f);
}

// Smooth the rows from `first` to before `last`, counted through the views in `order`, or through all.
//
// A thread goes down the rows of a view and keeps the last few, channel by channel, in rings; what is done to a row is
// then what vector units do.
void smooth_rows(
    Array3<Stored> views, Array3<float> valid, Array1<int> order, float scale, Number deviation, int first, int last,
    Array1<float> room, Array3<Smoothed> views_out) {
    typedef float Some __attribute__((ext_vector_type(LANES)));
    typedef float Anywhere __attribute__((ext_vector_type(LANES), aligned(4)));
    auto some = [](const float* from) { return (Some)*(const Anywhere*)from; };
    constexpr float near[] = {NEAR};
    const int height = views.shape[1], width = views.shape[2], wide = width + 2 * (REACH + 1) + LANES;
    const float unit = 1.f / (CHANNELS * deviation * deviation);
    const size_t row = (size_t)CHANNELS * wide;
    float* const colors = room.data;                // [RING, CHANNELS, wide]: row y in ring place y % RING
    float* const guides = colors + RING * row;      // the same
    float* const knowns = guides + RING * row;      // [RING, wide]: 1 where colors are valid
    float* const counts = knowns + (size_t)RING * wide;  // [RING, wide]: the same, but 0 outside of the frame
    float* const shares = counts + (size_t)RING * wide;  // [wide]
    auto within = [](int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; };
    int colored = 0, guided = 0;                    // rows of this view that are in the rings
    for (int i = first; i < last; ++i) {
        const int n = i / height, y = i - n * height;
        const size_t view = (size_t)(order.data ? order.data[n] : n) * height * width;
        if (i == first || y == 0) {
            colored = within(y - REACH - 1, height);
            guided = within(y - REACH, height);
        }
        const int bottom = within(y + REACH, height);
        for (; colored <= within(bottom + 1, height); ++colored) {
            const auto* const in = views.data + view + (size_t)colored * width;
            const float* const mask = valid.data + view + (size_t)colored * width;
            float* const known = knowns + (size_t)(colored % RING) * wide + REACH + 1;
            float* const count = counts + (size_t)(colored % RING) * wide + REACH + 1;
            for (int x = 0; x < width; ++x) count[x] = known[x] = !valid.data || mask[x] != 0.f ? 1.f : 0.f;
            for (int x = 1; x <= REACH + 1; ++x) {
                count[-x] = count[width - 1 + x] = 0.f;
                known[-x] = known[0];
                known[width - 1 + x] = known[width - 1];
            }
            for (int c = 0; c < CHANNELS; ++c) {
                float* const out = colors + (colored % RING) * row + (size_t)c * wide + REACH + 1;
                for (int x = 0; x < width; ++x) out[x] = known[x] != 0.f ? scale * (float)in[x].c[c] : 0.f;
                for (int x = 1; x <= REACH + 1; ++x) {
                    out[-x] = out[0];
                    out[width - 1 + x] = out[width - 1];
                }
            }
        }
        for (; guided <= bottom; ++guided) {
            const int above = within(guided - 1, height) % RING, here = guided % RING;
            const int below = within(guided + 1, height) % RING;
            auto add = [&](const float* a, const float* b, const float* d, float* out) {
                #pragma clang loop vectorize(assume_safety)
                for (int x = 1; x < wide - 1; ++x)
                    out[x] = a[x - 1] + a[x] + a[x + 1] + b[x - 1] + b[x] + b[x + 1] + d[x - 1] + d[x] + d[x + 1];
            };
            add(knowns + (size_t)above * wide, knowns + (size_t)here * wide, knowns + (size_t)below * wide, shares);
            for (int x = 1; x < wide - 1; ++x) shares[x] = 1.f / (shares[x] > 1.f ? shares[x] : 1.f);
            for (int c = 0; c < CHANNELS; ++c) {
                const float* const channel = colors + (size_t)c * wide;
                float* const out = guides + here * row + (size_t)c * wide;
                add(channel + above * row, channel + here * row, channel + below * row, out);
                for (int x = 1; x < wide - 1; ++x) out[x] *= shares[x];
            }
        }
        // As many columns as a few registers hold, with all that is added up for them.
        const float* const guide = guides + (y % RING) * row + REACH + 1;
        const float* const known = knowns + (size_t)(y % RING) * wide + REACH + 1;
        auto* const out = views_out.data + (size_t)i * width;
        const int above = y < REACH ? -y : -REACH, below = height - 1 - y < REACH ? height - 1 - y : REACH;
        for (int x = 0; x < width; x += LANES) {
            Some middle[CHANNELS], sum[CHANNELS], weights = 0.f;
            #pragma unroll
            for (int c = 0; c < CHANNELS; ++c) {
                middle[c] = some(guide + (size_t)c * wide + x);
                sum[c] = 0.f;
            }
            const Some likeness = unit * some(known + x);
            for (int dy = above; dy <= below; ++dy) {
                const size_t place = (y + dy) % RING;
                const float* const other = guides + place * row + REACH + 1 + x;
                const float* const color = colors + place * row + REACH + 1 + x;
                const float* const count = counts + place * wide + REACH + 1 + x;
                #pragma unroll
                for (int dx = -REACH; dx <= REACH; ++dx) {
                    Some unlike = 1.f;
                    #pragma unroll
                    for (int c = 0; c < CHANNELS; ++c) {
                        const Some difference = some(other + (size_t)c * wide + dx) - middle[c];
                        unlike += likeness * difference * difference;
                    }
                    const Some weight = near[dy + REACH] * near[dx + REACH] * some(count + dx) / (unlike * unlike);
                    #pragma unroll
                    for (int c = 0; c < CHANNELS; ++c) sum[c] += weight * some(color + (size_t)c * wide + dx);
                    weights += weight;
                }
            }
            for (int j = 0; j < LANES && x + j < width; ++j)
                for (int c = 0; c < CHANNELS; ++c)
                    out[x + j].c[c] = stored(weights[j] > 0.f ? sum[c][j] / weights[j] : 0.f);
        }
    }
}

// Average blocks of pixels; `row` and what follows it are rows of all reduced views, one view after the other.
void reduce_rows(
    int tid, Array3<Stored> views, Array3<float> valid, float scale, int row, int lanes, Array3<Reduced> views_out,
    Array3<float> valid_out) {
    const int line = row + tid / lanes, lane = tid % lanes, n = line / views_out.shape[1];
    const int y = line - n * views_out.shape[1];
    const int height = views.shape[1], width = views.shape[2], columns = views_out.shape[2];
    for (int x = lane; x < columns; x += lanes) {
        float sums[CHANNELS] = {};
        int known = 0;
        for (int dy = 0; dy < REDUCTION; ++dy)
            for (int dx = 0; dx < REDUCTION; ++dx) {
                const size_t p = ((size_t)n * height + y * REDUCTION + dy) * width + x * REDUCTION + dx;
                if (valid.data && valid.data[p] == 0.f) continue;
                for (int c = 0; c < CHANNELS; ++c) sums[c] += (float)views.data[p].c[c];
                ++known;
            }
        const size_t q = ((size_t)n * views_out.shape[1] + y) * columns + x;
        for (int c = 0; c < CHANNELS; ++c)
            views_out.data[q].c[c] = stored(known ? scale * sums[c] / known : 0.f);
        if (valid.data) valid_out.data[q] = known == REDUCTION * REDUCTION ? 1.f : 0.f;
    }
}
