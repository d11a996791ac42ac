// The plane sweep on a CPU.
//
// A thread sweeps some rows in chunks of columns that stay in its cache, with all disparities and views, so that all
// loops over a chunk have a length that the compiler knows: it makes vectors of them without a rest. Views are kept
// channel by channel, with a margin at their left and right in which they go on as at their border: nothing in a chunk
// has to ask whether it is outside. Views that belong to the same view sets are added up in one group, and the sums of
// the groups once, at the end, to those of the sets. The views that see a pixel past a surface are one set.
#pragma once
#include "lfgpu.h"

// Keep the views from `first` to before `last` channel by channel; their rows go on at both sides as at their border.
void keep_views(Array3<Stored> views, int margin, int first, int last, Array4<Kept> kept_out) {
    const int height = views.shape[1], width = views.shape[2], long_row = kept_out.shape[3];
    for (int line = first * height; line < last * height; ++line) {
        const int n = line / height, y = line % height;
        const auto* const row = views.data + (size_t)line * width;
        auto* const out = kept_out.data + ((size_t)n * CHANNELS * height + y) * long_row + margin;
        const size_t plane = (size_t)height * long_row;
        #pragma clang loop vectorize(assume_safety)
        for (int x = 0; x < width; ++x)
            #pragma unroll
            for (int c = 0; c < CHANNELS; ++c) out[c * plane + x] = row[x].c[c];
        for (int c = 0; c < CHANNELS; ++c) {
            for (int x = -margin; x < 0; ++x) out[(long long)(c * plane) + x] = row[0].c[c];
            for (int x = width; x < long_row - margin; ++x) out[c * plane + x] = row[width - 1].c[c];
        }
    }
}

// Sweep the rows from `first` to before `last`.
void sweep_rows(
    Array4<Kept> views, int margin, Array3<float> image, Array3<float> valid, Array3<float> nearest, Array1<int> order,
    Array1<int> members, int groups, Array2<vec4f> shifts, Array1<float> limits, int view_sets, float scale,
    float truncation, float gradient_weight, float gradient_truncation, Number softness, float preference, float least,
    int first, int last, Array1<float> room, Array3<float> volume_out) {
    const int height = image.shape[1], width = image.shape[2] - LANES, views_there = order.shape[0];
    const int labels = volume_out.shape[0], long_row = views.shape[3];
    const size_t plane = (size_t)height * width, long_plane = (size_t)height * long_row;
    const bool seen = nearest.data, counted = seen || valid.data;
    // Of stored values, not intensities, and sums over channels instead of means.
    const float most_color = CHANNELS * truncation / scale, most_slope = 4 * CHANNELS * gradient_truncation / scale;
    const float fade = 1.f / (1.f + gradient_weight);
    // Of rooted intensities 2 s (sqrt(1 + x / s) - 1) only the root is added up.
    const float mean_color = scale / CHANNELS, inner = ROOTED ? mean_color / softness : 1.f;
    const float outer = fade * (ROOTED ? 2.f * softness : mean_color);
    const float of_slope = 0.25f * gradient_weight * (ROOTED ? 0.5f * inner : 1.f);
    auto rooted = [&](auto x) {
        if constexpr (ROOTED) return __builtin_sqrtf(1.f + inner * x);
        return x;
    };
    const float most = outer * (rooted(most_color) + of_slope * most_slope - ROOTED);

    const size_t sum_size = (size_t)STRIP * LANES;
    float* const differences = room.data;                    // [3, CHANNELS, LANES + 2], row y in ring place y % 3
    float* const before = differences + 3 * CHANNELS * (LANES + 2);  // [CHANNELS, LANES], the row above
    float* const costs = before + CHANNELS * LANES;          // [groups, STRIP, LANES]
    float* const counts = costs + groups * sum_size;         // the same
    float* const best = counts + groups * sum_size;          // [STRIP, LANES]
    float sizes[LANES + 1] = {};                             // of differences, if there are no gradients
    auto least_of = [](auto a, auto b) { return a < b ? a : b; };
    auto size_of = [](float a) { return __builtin_fabsf(a); };
    auto within = [](int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; };
    struct No { enum { is = 0 }; };
    struct Yes { enum { is = 1 }; };

    for (int i = 0; i < 4 * CHANNELS * LANES; ++i) differences[i] = 0.f;  // beside a chunk nothing is slow to add
    for (int top = first; top < last; top += STRIP)
    for (int done = 0; done < width; done += LANES - 2) {
        const int bottom = least_of(top + STRIP, last), columns = least_of(width, LANES - 2);
        const int x0 = least_of(done, width - columns);  // the last chunk does some columns again
        for (int l = 0; l < labels; ++l) {
            for (size_t i = 0; i < groups * sum_size; ++i) costs[i] = 0.f;
            if (counted) for (size_t i = 0; i < groups * sum_size; ++i) counts[i] = 0.f;
            const float deepest = limits.data[l];
            int group = 0;
            for (int k = 0; k < views_there; ++k) {
                if (k > 0 && members.data[k] != members.data[k - 1]) ++group;
                const int n = order.data[k];
                const auto shift = shifts.data[l * views_there + k];
                const int dx = (int)shift.c[0], dy = (int)shift.c[1];
                const float ax = shift.c[2], ay = shift.c[3];
                const int left = dx < 0 ? -dx : 0, right = least_of(width, width - dx - (ax > 0.f));
                const int begin = top > -dy ? top : -dy, end = least_of(bottom, height - dy - (ay > 0.f));
                const int from = left > x0 ? left - x0 : 0, to = least_of(right - x0, columns);
                if (from >= to || begin >= end) continue;

                const auto* const shown = views.data + n * CHANNELS * long_plane + margin + x0 - 1 + dx;
                auto level = [&](auto across, const auto* row, int j) {
                    const float here = (float)row[j];
                    if constexpr (!decltype(across)::is) return here;
                    return here + ax * ((float)row[j + 1] - here);
                };
                auto keep_row_above = [&](auto across, int y) {
                    for (int c = 0; c < CHANNELS; ++c) {
                        const size_t t = within(y + dy, height);
                        const auto* const row = shown + c * long_plane + t * long_row;
                        for (int j = 0; j < LANES; ++j) before[c * LANES + j] = level(across, row, j);
                    }
                };
                auto find_differences = [&](auto across, auto down, int y) {
                    if constexpr (!GRADIENTS) {  // each difference is asked for once
                        const size_t t = within(y + dy + decltype(down)::is, height);
                        const auto* const row = shown + t * long_row;
                        const float* const color = image.data + (size_t)y * (width + LANES) + x0;
                        #pragma clang loop vectorize(assume_safety)
                        for (int j = 0; j < LANES; ++j) {
                            float size = 0.f;
                            #pragma unroll
                            for (int c = 0; c < CHANNELS; ++c) {
                                float value = level(across, row + c * long_plane, j);
                                if constexpr (decltype(down)::is) {
                                    const float upper = before[c * LANES + j];
                                    before[c * LANES + j] = value;
                                    value = upper + ay * (value - upper);
                                }
                                size += size_of(value - color[(size_t)c * height * (width + LANES) + j]);
                            }
                            sizes[j] = size;
                        }
                    } else if (y < height) for (int c = 0; c < CHANNELS; ++c) {
                        const int t = within(y + dy + decltype(down)::is, height);
                        const auto* const row = shown + c * long_plane + (size_t)t * long_row;
                        const float* const color = image.data + ((size_t)c * height + y) * (width + LANES) + x0;
                        float* const previous = before + c * LANES;
                        float* const out = differences + (y % 3 * CHANNELS + c) * (LANES + 2);
                        #pragma clang loop vectorize(assume_safety)
                        for (int j = 0; j < LANES; ++j) {
                            float value = level(across, row, j);
                            if constexpr (decltype(down)::is) {
                                const float upper = previous[j];
                                previous[j] = value;
                                value = upper + ay * (value - upper);
                            }
                            out[j] = value - color[j];
                        }
                        if (x0 == 0) out[0] = out[1];
                        if (x0 + columns == width) out[columns + 1] = out[columns];
                    }
                };
                const int above = GRADIENTS && begin > 0 ? begin - 1 : begin;
                if (ay > 0.f && ax > 0.f) keep_row_above(Yes(), above);
                else if (ay > 0.f) keep_row_above(No(), above);
                for (int y = above; y < end + GRADIENTS; ++y) {
                    if (ax > 0.f && ay > 0.f) find_differences(Yes(), Yes(), y);
                    else if (ax > 0.f) find_differences(Yes(), No(), y);
                    else if (ay > 0.f) find_differences(No(), Yes(), y);
                    else find_differences(No(), No(), y);
                    const int at = y - GRADIENTS;  // whose row below is there
                    if (at < begin) continue;
                    auto row_of = [&](int r) {
                        return differences + within(r, height) % 3 * CHANNELS * (LANES + 2);
                    };
                    const float* const upper = row_of(at - 1);
                    const float* const here = row_of(at);
                    const float* const lower = row_of(at + 1);
                    float* const cost = costs + group * sum_size + (at - top) * LANES;
                    auto robust = [&](int j) {
                        if constexpr (!GRADIENTS) return rooted(least_of(sizes[j + 1], most_color));
                        float color = 0.f, slope = 0.f;
                        #pragma unroll
                        for (int c = 0; c < CHANNELS; ++c) {
                            const int i = c * (LANES + 2) + j;
                            color += size_of(here[i + 1]);
                            slope += size_of(here[i + 2] - here[i]) + size_of(lower[i + 1] - upper[i + 1]);
                        }
                        return rooted(least_of(color, most_color)) + of_slope * least_of(slope, most_slope);
                    };
                    if (!counted && from == 0 && to == LANES - 2) {
                        #pragma clang loop vectorize(assume_safety)
                        for (int j = 0; j < LANES; ++j) cost[j] += robust(j);
                        continue;
                    }
                    const size_t near = n * plane + (size_t)(at + dy + (ay >= 0.5f)) * width;
                    const int near_x = x0 + dx + (ax >= 0.5f);
                    if (seen && at + 1 < end)  // views lie too far apart for the cache to guess what comes next
                        for (int j = from; j < to; j += 16)
                            __builtin_prefetch(nearest.data + near + width + j + near_x);
                    float found[LANES];
                    #pragma clang loop vectorize(assume_safety)
                    for (int j = 0; j < LANES; ++j) found[j] = robust(j);
                    if (!counted) {
                        for (int j = from; j < to; ++j) cost[j] += found[j];
                        continue;
                    }
                    const float* const mask = valid.data + near;
                    const float* const surface = nearest.data + near;
                    float* const count = cost + groups * sum_size;
                    auto add = [&](auto takes_part) {
                        #pragma clang loop vectorize(assume_safety)
                        for (int j = from; j < to; ++j) {
                            const bool part = takes_part(j);
                            cost[j] += part ? found[j] : 0.f;
                            count[j] += part ? 1.f : 0.f;
                        }
                    };
                    if (seen && valid.data)
                        add([&](int j) { return mask[j + near_x] != 0.f && surface[j + near_x] <= deepest; });
                    else if (seen) add([&](int j) { return surface[j + near_x] <= deepest; });
                    else add([&](int j) { return mask[j + near_x] != 0.f; });
                }
            }

            for (int m = 0; m < view_sets; ++m) {
                // Of the views of this set: work(view, its group, whether it is the group's first one).
                auto for_views = [&](auto work) {
                    for (int k = 0, group = 0; k < views_there; ++k) {
                        const bool leads = k == 0 || members.data[k] != members.data[k - 1];
                        group += k > 0 && leads;
                        if ((unsigned)members.data[k] >> m & 1u) work(k, group, leads);
                    }
                };
                float count[LANES];
                auto count_views = [&](int y) {
                    for (int j = 0; j < LANES; ++j) count[j] = 0.f;
                    for_views([&](int k, int, bool) {
                        const auto shift = shifts.data[l * views_there + k];
                        const int dx = (int)shift.c[0], dy = (int)shift.c[1];
                        if (y + dy < 0 || y + dy + (shift.c[3] > 0.f) >= height) return;
                        const int to = least_of(width - dx - (shift.c[2] > 0.f) - x0, columns);
                        for (int j = dx + x0 < 0 ? -dx - x0 : 0; j < to; ++j) count[j] += 1.f;
                    });
                };
                bool is_cut = false;  // whether a view shows only some of the rows
                if (!counted) for_views([&](int k, int, bool) {
                    const auto shift = shifts.data[l * views_there + k];
                    const int dy = (int)shift.c[1];
                    is_cut |= top + dy < 0 || bottom + dy + (shift.c[3] > 0.f) > height;
                });
                const float factor = outer * (m == 0 ? 1.f : 1.f + preference);
                const float extra = m == 0 ? 0.f : PENALTY, needed = m == 0 ? least : 1.f;
                for (int y = top; y < bottom; ++y) {
                    if (!counted && (y == top || is_cut)) count_views(y);
                    float total[LANES] = {};
                    auto take = [&](int g) {
                        const size_t place = g * sum_size + (y - top) * LANES;
                        for (int j = 0; j < LANES; ++j) total[j] += costs[place + j];
                        if (counted) for (int j = 0; j < LANES; ++j) count[j] += counts[place + j];
                    };
                    if (counted) for (int j = 0; j < LANES; ++j) count[j] = 0.f;
                    for_views([&](int, int group, bool leads) { if (leads) take(group); });
                    float* const out = best + (y - top) * LANES;
                    for (int j = 0; j < LANES; ++j) {
                        const float mean = factor * (total[j] / (count[j] > 1.f ? count[j] : 1.f) - ROOTED);
                        const float value = count[j] >= needed ? mean + extra : most;
                        out[j] = m == 0 || value < out[j] ? value : out[j];
                    }
                }
            }
            for (int y = top; y < bottom; ++y) {
                float* const out = volume_out.data + l * plane + (size_t)y * width + x0;
                for (int j = 0; j < columns; ++j) out[j] = best[(y - top) * LANES + j];
            }
        }
    }
}
