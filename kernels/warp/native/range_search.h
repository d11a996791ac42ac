// Views compared at a low resolution, to find which disparities there are.
//
// All of it goes through BLOCK columns of a row at once: a CPU's vector units work on them together. A thread of a GPU
// has one column. Thread tid has line row + tid / lanes, and there every lanes-th block of columns.
#pragma once
#include "lfgpu.h"

// Average blocks of pixels over all channels; NaN where one is not valid.
void shrink(
    int tid, Array3<Stored> views, Array1<int> chosen, Array3<float> valid, float scale, int factor, int row, int lanes,
    Array3<float> images_out) {
    const int line = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < images_out.shape[2]; x0 += lanes * BLOCK) {
        const int height = images_out.shape[1], width = images_out.shape[2], full = views.shape[2];
        const int k = line / height, y = line - k * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        const size_t at = (size_t)y * factor * full + (size_t)x0 * factor, size = (size_t)views.shape[1] * full;
        float total[BLOCK] = {}, unknown[BLOCK] = {};
        for (int r = 0; r < factor; ++r) {
            const auto* const from = views.data + chosen.data[k] * size + at + (size_t)r * full;
            for (int j = 0; j < columns; ++j)
                for (int s = 0; s < factor; ++s)
                    for (int c = 0; c < CHANNELS; ++c) total[j] += (float)from[j * factor + s].c[c];
            if (!valid.data) continue;
            const float* const mask = valid.data + k * size + at + (size_t)r * full;
            for (int j = 0; j < columns; ++j)
                for (int s = 0; s < factor; ++s) unknown[j] += mask[j * factor + s] != 0.f ? 0.f : 1.f;
        }
        float* const out = images_out.data + (size_t)line * width + x0;
        const float share = scale / (float)(factor * factor * CHANNELS);
        for (int j = 0; j < columns; ++j) out[j] = unknown[j] == 0.f ? share * total[j] : NAN;
    }
}

// Average blocks of pixels of images.
void shrink_again(int tid, Array3<float> images, int factor, int row, int lanes, Array3<float> smaller_out) {
    const int line = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < smaller_out.shape[2]; x0 += lanes * BLOCK) {
        const int height = smaller_out.shape[1], width = smaller_out.shape[2], full = images.shape[2];
        const int n = line / height, y = line - n * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        const float* const from = images.data + ((size_t)n * images.shape[1] + y * factor) * full + (size_t)x0 * factor;
        float total[BLOCK] = {};
        for (int r = 0; r < factor; ++r)
            for (int j = 0; j < columns; ++j)
                for (int s = 0; s < factor; ++s) total[j] += from[(size_t)r * full + j * factor + s];
        float* const out = smaller_out.data + (size_t)line * width + x0;
        for (int j = 0; j < columns; ++j) out[j] = total[j] / (float)(factor * factor);
    }
}

// Sums along rows of what is known, and how many pixels they are of.
void add_rows(int tid, Array3<float> images, int window, int row, int lanes, Array3<vec2f> sums_out) {
    const int line = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < images.shape[2]; x0 += lanes * BLOCK) {
        const int width = images.shape[2], columns = width - x0 < BLOCK ? width - x0 : BLOCK, radius = window / 2;
        const float* const from = images.data + (size_t)line * width;
        float total[BLOCK] = {}, known[BLOCK] = {};
        for (int k = x0 - radius; k <= x0 + radius; ++k) {
            float values[BLOCK];
            const int begin = k >= 0 ? 0 : -k < columns ? -k : columns;
            const int end = width - k >= columns ? columns : width - k > begin ? width - k : begin;
            for (int j = 0; j < begin; ++j) values[j] = from[0];
            for (int j = begin; j < end; ++j) values[j] = from[k + j];
            for (int j = end; j < columns; ++j) values[j] = from[width - 1];
            for (int j = 0; j < columns; ++j) {
                const bool is_known = values[j] == values[j];
                total[j] += is_known ? values[j] : 0.f;
                known[j] += is_known ? 1.f : 0.f;
            }
        }
        wp::vec2f* const out = sums_out.data + (size_t)line * width + x0;
        for (int j = 0; j < columns; ++j) {
            out[j].c[0] = total[j];
            out[j].c[1] = known[j];
        }
    }
}

// Sums down columns, and what their mean leaves of the images.
void subtract_means(
    int tid, Array3<float> images, Array3<vec2f> sums, int window, int row, int lanes, Array3<float> details_out) {
    const int line = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < images.shape[2]; x0 += lanes * BLOCK) {
        const int height = images.shape[1], width = images.shape[2], radius = window / 2;
        const int n = line / height, y = line - n * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        float total[BLOCK] = {}, known[BLOCK] = {};
        for (int k = -radius; k <= radius; ++k) {
            const int r = y + k < 0 ? 0 : y + k < height ? y + k : height - 1;
            const wp::vec2f* const from = sums.data + ((size_t)n * height + r) * width + x0;
            for (int j = 0; j < columns; ++j) {
                total[j] += from[j].c[0];
                known[j] += from[j].c[1];
            }
        }
        const size_t at = (size_t)line * width + x0;
        for (int j = 0; j < columns; ++j)
            details_out.data[at + j] = images.data[at + j] - total[j] / (known[j] > 1.f ? known[j] : 1.f);
    }
}

// Differences of each side at the disparities from `first` on: their sums over views, and how many they are.
void add_differences(
    int tid, Array3<float> details, int reference, Array2<vec4f> shifts, Array1<int> views, Array1<int> ends, int first,
    int row, int lanes, Array3<vec2f> sums_out) {
    const int line = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < details.shape[2]; x0 += lanes * BLOCK) {
        const int height = details.shape[1], width = details.shape[2], sides = ends.shape[0] - 1;
        const int slice = line / height, y = line - slice * height, side = slice % sides, label = first + slice / sides;
        const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        const size_t plane = (size_t)height * width;
        const float* const image = details.data + reference * plane + (size_t)y * width + x0;
        float total[BLOCK] = {}, parts[BLOCK] = {};
        for (int k = ends.data[side]; k < ends.data[side + 1]; ++k) {
            const wp::vec4f shift = shifts.data[(size_t)label * views.shape[0] + k];
            const int dx = (int)shift.c[0], dy = (int)shift.c[1], right = shift.c[2] > 0.f, down = shift.c[3] > 0.f;
            if (y + dy < 0 || y + dy + down >= height) continue;
            const int begin = -dx - x0 > 0 ? -dx - x0 : 0;
            const int end = width - dx - right - x0 < columns ? width - dx - right - x0 : columns;
            const float* const upper = details.data + views.data[k] * plane + (long long)(y + dy) * width + x0 + dx;
            const float* const lower = upper + width;
            const float ax = shift.c[2], ay = shift.c[3];
            auto add = [&](auto shown) {
                for (int j = begin; j < end; ++j) {
                    const float difference = shown(j) - image[j];
                    const bool is_known = difference == difference;
                    total[j] += is_known ? difference < 0.f ? -difference : difference : 0.f;
                    parts[j] += is_known ? 1.f : 0.f;
                }
            };
            // What has no share is not looked at: it may be unknown, or outside.
            auto along = [&](const float* row, int j) { return row[j] + ax * (row[j + right] - row[j]); };
            if (!down) add([&](int j) { return along(upper, j); });
            else add([&](int j) { return along(upper, j) + ay * (along(lower, j) - along(upper, j)); });
        }
        wp::vec2f* const out = sums_out.data + (size_t)line * width + x0;
        for (int j = 0; j < columns; ++j) {
            out[j].c[0] = total[j];
            out[j].c[1] = parts[j];
        }
    }
}

// The least mean over 3 x 3 pixels of the sides of each line.
void find_costs(
    int tid, Array3<vec2f> sums, Array1<int> ends, Array1<int> lines, int first, int row, int lanes,
    Array4<float> volume_out) {
    const int line = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < volume_out.shape[3]; x0 += lanes * BLOCK) {
        const int count = volume_out.shape[1], height = volume_out.shape[2], width = volume_out.shape[3];
        const int sides = ends.shape[0] - 1;
        const int slice = line / height, y = line - slice * height, columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        const int above = y > 0 ? y - 1 : 0, below = y + 1 < height ? y + 1 : y;
        for (int m = 0; m + 1 < lines.shape[0]; ++m) {
            float* const out = volume_out.data + (((size_t)m * count + first + slice) * height + y) * width + x0;
            float least[BLOCK];
            for (int j = 0; j < BLOCK; ++j) least[j] = UNSEEN;
            for (int side = lines.data[m]; side < lines.data[m + 1]; ++side) {
                const wp::vec2f* const from = sums.data + ((size_t)slice * sides + side) * height * width + x0;
                float total[BLOCK + 2] = {}, parts[BLOCK + 2] = {};
                const int begin = x0 > 0 ? -1 : 0, end = x0 + columns < width ? columns + 1 : columns;
                for (int r = above; r <= below; ++r) {
                    const wp::vec2f* const level = from + (size_t)r * width;
                    for (int j = begin; j < end; ++j) {
                        total[j + 1] += level[j].c[0];
                        parts[j + 1] += level[j].c[1];
                    }
                }
                const float needed = 4.5f * (ends.data[side + 1] - ends.data[side]);
                for (int j = 0; j < BLOCK; ++j) {
                    const float part = parts[j] + parts[j + 1] + parts[j + 2];
                    const float mean = (total[j] + total[j + 1] + total[j + 2]) / (part > 1.f ? part : 1.f);
                    least[j] = part >= needed && mean < least[j] ? mean : least[j];
                }
            }
            for (int j = 0; j < columns; ++j) out[j] = least[j];
        }
    }
}

// The least cost, where it is, and how far it lies below others: what `distinct_minimum` says.
void find_distinct(
    int tid, Array4<float> volume, int apart, int row, int lanes, Array2<float> place_out, Array2<float> least_out,
    Array2<float> spread_out, Array2<float> others_out, Array2<float> worst_out) {
    const int y = row + tid / lanes;
    for (int x0 = tid % lanes * BLOCK; x0 < volume.shape[3]; x0 += lanes * BLOCK) {
        const int m = volume.shape[0], count = volume.shape[1], height = volume.shape[2], width = volume.shape[3];
        const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        const size_t plane = (size_t)height * width, at = (size_t)y * width + x0;
        const float* const costs = volume.data + at;
        const float* const second = costs + (m - 1) * count * plane;  // of the second line, if there is one
        auto mean = [&](int l, int j) {
            const float a = costs[l * plane + j], b = second[l * plane + j];
            return 0.5f * ((a < 1.f ? a : 1.f) + (b < 1.f ? b : 1.f));
        };
        float least[BLOCK], most[BLOCK], others[BLOCK];
        int places[BLOCK];
        for (int j = 0; j < columns; ++j) {
            least[j] = most[j] = mean(0, j);
            places[j] = 0;
            others[j] = UNSEEN;
        }
        for (int l = 1; l < count; ++l)
            for (int j = 0; j < columns; ++j) {
                const float cost = mean(l, j);
                places[j] = cost < least[j] ? l : places[j];
                least[j] = cost < least[j] ? cost : least[j];
                most[j] = cost > most[j] ? cost : most[j];
            }
        for (int l = 0; l < count; ++l)
            for (int j = 0; j < columns; ++j) {
                const float cost = mean(l, j);
                const bool away = l > places[j] + apart || l < places[j] - apart;
                others[j] = away && cost < others[j] ? cost : others[j];
            }
        for (int j = 0; j < columns; ++j) {
            const int k = places[j];
            const bool inner = k > 0 && k < count - 1;
            float t = 0.f, worst = UNSEEN;
            if (inner) {
                const float down = least[j] - mean(k - 1, j), up = mean(k + 1, j) - least[j], bend = up - down;
                t = bend > 1e-9f ? -(up + down) / (2.f * bend) : 0.f;
                t = t < -1.f ? -1.f : t > 1.f ? 1.f : t;
                const float a = costs[k * plane + j], b = second[k * plane + j];
                worst = a > b ? a : b;
            }
            place_out.data[at + j] = k + t;
            least_out.data[at + j] = least[j];
            spread_out.data[at + j] = least[j] < 1.f ? most[j] - least[j] : NAN;
            others_out.data[at + j] = others[j] < UNSEEN ? others[j] - least[j] : UNSEEN;
            worst_out.data[at + j] = worst;
        }
    }
}

// The mean disparity of a pixel that is sure of it and of its neighbours that have the same.
void find_agreeing(
    int tid, Array2<float> place, Array2<float> others, Array2<float> worst, Array1<double> noise, double least_noise,
    double same, double other, int neighbors, float first, float step, int row, int lanes,
    Array2<float> disparity_out) {
    const int y = row + tid / lanes, height = place.shape[0], width = place.shape[1];
    const double s = noise.data[0] > least_noise ? noise.data[0] : least_noise;
    const float most = same * s < 1. ? same * s : 1., least = other * s;
    auto is_sure = [&](size_t at) { return worst.data[at] <= most && others.data[at] >= least; };
    auto disparity_of = [&](size_t at) {
        const float along = step * place.data[at];  // a sum of its own, rounded as everywhere
        return first + along;
    };
    for (int x = tid % lanes; x < width; x += lanes) {
        const size_t at = (size_t)y * width + x;
        float total = 0.f;
        int count = 0;
        if (is_sure(at)) {
            const float here = disparity_of(at), tolerance = 1.5f * step;
            for (int r = y > 0 ? y - 1 : 0; r <= y + 1 && r < height; ++r)
                for (int q = x > 0 ? x - 1 : 0; q <= x + 1 && q < width; ++q) {
                    const size_t near = (size_t)r * width + q;
                    const float there = disparity_of(near), apart = there - here;
                    if (!is_sure(near) || apart > tolerance || apart < -tolerance) continue;
                    total += there;
                    ++count;
                }
        }
        disparity_out.data[at] = count > neighbors ? total / count : NAN;
    }
}
