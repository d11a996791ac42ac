// What the confidence is made of, on a CPU: many columns at a time.
#pragma once
#include "lfgpu.h"
#include "exponential.h"

// The evidence of a row, from its costs and its path costs.
void weigh_evidence(
    int tid, Array3<float> volume, Array3<float> path_costs, Number labels, float step, Number unit, int row,
    int lanes, Array2<float> conflict_out, Array2<float> evidence_out, Array2<float> cost_out) {
    const int width = volume.shape[2], count = (int)labels, y = row + tid;
    const size_t size = (size_t)volume.shape[1] * width;
    for (int x = 0; x < width; x += BLOCK) {
        const int columns = width - x < BLOCK ? width - x : BLOCK;
        const size_t place = (size_t)y * width + x;
        const float* const costs = volume.data + place;
        const float* const paths = path_costs.data + place;
        float least[BLOCK], least_path[BLOCK], rivals[BLOCK] = {};
        for (int j = 0; j < columns; ++j) {
            least[j] = costs[j];
            least_path[j] = paths[j];
        }
        for (int l = 1; l < count; ++l)
            for (int j = 0; j < columns; ++j) {
                least[j] = costs[l * size + j] < least[j] ? costs[l * size + j] : least[j];
                least_path[j] = paths[l * size + j] < least_path[j] ? paths[l * size + j] : least_path[j];
            }
        const float sharpness = SHARPNESS / unit;
        for (int l = 0; l < count; ++l)
            for (int j = 0; j < columns; ++j)
                rivals[j] += exp_of(sharpness * (least[j] - costs[l * size + j]));
        for (int j = 0; j < columns; ++j) {
            const float more = least_path[j] / PATHS - least[j], cost = least[j] / unit;
            conflict_out.data[place + j] = log_of((more > 0.f ? more : 0.f) / unit + LEAST_CONFLICT);
            evidence_out.data[place + j] = -log_of(step * rivals[j]);
            cost_out.data[place + j] = log_of(cost > LEAST_COST ? cost : LEAST_COST);
        }
    }
}

// Means along an axis: of a row.
void average_line(
    int tid, Array2<float> values, int down, int across, int reach, int row, int lanes, Array2<float> means_out) {
    const int height = values.shape[0], width = values.shape[1], y = row + tid;
    for (int x = 0; x < width; x += BLOCK) {
        const int columns = width - x < BLOCK ? width - x : BLOCK;
        float total[BLOCK] = {};
        for (int k = -reach; k <= reach; ++k) {
            const int line = y + k * down, column = x + k * across;
            if (line < 0 || line >= height) continue;
            const float* const other = values.data + (long long)line * width + column;
            const int end = width - column < columns ? width - column : columns;
            for (int j = column < 0 ? -column : 0; j < end; ++j) total[j] += other[j];
        }
        const int size = down ? height : width;
        for (int j = 0; j < columns; ++j) {
            const int before = down ? y : x + j, after = size - 1 - before;
            const int count = 1 + (before < reach ? before : reach) + (after < reach ? after : reach);
            means_out.data[(size_t)y * width + x + j] = total[j] / count;
        }
    }
}

// How far the map is from a plane, and how deep it is, in the rows from `first` to before `last`.
void find_unevenness(
    Array2<float> disparity, int first, int last, Array1<float> room, Array2<float> bend_out,
    Array2<float> relief_out) {
    const int height = disparity.shape[0], width = disparity.shape[1], wide = width + 2 * AROUND;
    float* const logs = room.data;                 // [3, wide]: of row y in ring place y % 3, with a margin
    float* const nearest = logs + 3 * wide;        // [wide], of the rows around
    float* const farthest = nearest + wide;        // the same
    auto within = [](int i, int size) { return i < 0 ? 0 : i < size ? i : size - 1; };
    auto ring_of = [&](int y) { return logs + (y + 3) % 3 * wide + AROUND; };
    auto row_of = [&](int y) { return disparity.data + (size_t)within(y, height) * width; };
    int known = first - 1;                         // rows from here on are not in the ring
    for (int y = first; y < last; ++y) {
        for (; known <= y + 1; ++known) {          // beside the image, too, which goes on as at its border
            const float* const above = row_of(known - 1);
            const float* const level = row_of(known);
            const float* const below = row_of(known + 1);
            float* const out = ring_of(known);
            auto bend = [&](int x, int before, int after) {
                const float here = level[x];
                float sum = __builtin_fabsf((level[before] - here) + (level[after] - here));
                sum += __builtin_fabsf((above[x] - here) + (below[x] - here));
                sum += __builtin_fabsf((above[before] - here) + (below[after] - here));
                sum += __builtin_fabsf((above[after] - here) + (below[before] - here));
                return log_of(0.25f * sum + LEAST_BEND);
            };
            #pragma clang loop vectorize(assume_safety)
            for (int x = 1; x < width - 1; ++x) out[x] = bend(x, x - 1, x + 1);
            out[0] = bend(0, 0, within(1, width));
            out[width - 1] = bend(width - 1, within(width - 2, width), width - 1);
            out[-1] = bend(0, 0, 0);
            out[width] = bend(width - 1, width - 1, width - 1);
        }
        const float* const above = ring_of(y - 1);
        const float* const level = ring_of(y);
        const float* const below = ring_of(y + 1);
        float* const bends = bend_out.data + (size_t)y * width;
        #pragma clang loop vectorize(assume_safety)
        for (int x = 0; x < width; ++x)
            bends[x] = (above[x - 1] + above[x] + above[x + 1] + level[x - 1] + level[x] + level[x + 1]
                + below[x - 1] + below[x] + below[x + 1]) / 9.f;
        float* const high = nearest + AROUND;
        float* const low = farthest + AROUND;
        const float* const here = row_of(y);
        for (int x = 0; x < width; ++x) high[x] = low[x] = here[x];
        for (int k = -AROUND; k <= AROUND; ++k) {
            const float* const other = row_of(y + k);
            #pragma clang loop vectorize(assume_safety)
            for (int x = 0; x < width; ++x) {
                high[x] = other[x] > high[x] ? other[x] : high[x];
                low[x] = other[x] < low[x] ? other[x] : low[x];
            }
        }
        for (int k = 1; k <= AROUND; ++k) {
            high[-k] = high[0];
            high[width - 1 + k] = high[width - 1];
            low[-k] = low[0];
            low[width - 1 + k] = low[width - 1];
        }
        float* const reliefs = relief_out.data + (size_t)y * width;
        #pragma clang loop vectorize(assume_safety)
        for (int x = 0; x < width; ++x) {
            float most = high[x], least = low[x];
            #pragma unroll
            for (int k = -AROUND; k <= AROUND; ++k) {
                most = high[x + k] > most ? high[x + k] : most;
                least = low[x + k] < least ? low[x + k] : least;
            }
            reliefs[x] = log_of(most - least + LEAST_RELIEF);
        }
    }
}
