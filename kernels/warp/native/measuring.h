// Differences in windows of an image that noise alone would make; of BLOCK columns of a row at once, as on a CPU.
#pragma once
#include "lfgpu.h"

// Fourth differences down and along, and whether one of the pixels has the value of a limit.
void find_differences(
    int tid, Array2<Pixel> image, Array2<float> limits, float unit, int row, int lanes, Array2<float> differences_out,
    Array2<float> limited_out) {
    const int y = row + tid / lanes, width = differences_out.shape[1], full = image.shape[1];
    for (int x0 = tid % lanes * BLOCK; x0 < width; x0 += lanes * BLOCK) {
        const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        float total[BLOCK] = {};
        bool limited[BLOCK + 4] = {};
        for (int c = 0; c < CHANNELS; ++c) {
            const float low = limits.data[c], high = limits.data[CHANNELS + c];
            float along[BLOCK + 4];
            for (int j = 0; j < columns + 4; ++j) {
                float down[5];
                for (int k = 0; k < 5; ++k) {
                    down[k] = image.data[(size_t)(y + k) * full + x0 + j].c[c];
                    limited[j] |= down[k] == low || down[k] == high;
                }
                for (int left = 4; left > 0; --left)
                    for (int k = 0; k < left; ++k) down[k] = down[k + 1] - down[k];
                along[j] = down[0];
            }
            for (int left = 4; left > 0; --left)
                for (int j = 0; j < columns + left - 1; ++j) along[j] = along[j + 1] - along[j];
            for (int j = 0; j < columns; ++j) total[j] += along[j] < 0.f ? -along[j] : along[j];
        }
        const size_t at = (size_t)y * width + x0;
        for (int j = 0; j < columns; ++j) {
            const bool is_limited = limited[j] || limited[j + 1] || limited[j + 2] || limited[j + 3] || limited[j + 4];
            differences_out.data[at + j] = total[j] / CHANNELS * unit;
            limited_out.data[at + j] = is_limited ? 1.f : 0.f;
        }
    }
}

// Means over WINDOW x WINDOW pixels; NaN where they are least and limited.
void find_grain(
    int tid, Array2<float> differences, Array2<float> limited, float least, int row, int lanes,
    Array2<float> grain_out) {
    const int y = row + tid / lanes, height = grain_out.shape[0], width = grain_out.shape[1], reach = WINDOW / 2;
    auto mirrored = [](int k, int size) { return k < 0 ? -1 - k : k < size ? k : 2 * size - 1 - k; };
    for (int x0 = tid % lanes * BLOCK; x0 < width; x0 += lanes * BLOCK) {
        const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        float down[BLOCK + WINDOW - 1];
        for (int j = 0; j < columns + WINDOW - 1; ++j) {
            const float* const from = differences.data + mirrored(x0 + j - reach, width);
            down[j] = 0.f;
            for (int k = -reach; k <= reach; ++k) down[j] += from[(size_t)mirrored(y + k, height) * width];
        }
        for (int j = 0; j < columns; ++j) {
            float total = 0.f;
            for (int k = 0; k < WINDOW; ++k) total += down[j + k];
            float mean = total / (WINDOW * WINDOW);
            for (int k = 0; k < WINDOW * WINDOW && mean <= least; ++k) {
                const int r = mirrored(y + k / WINDOW - reach, height);
                const int q = mirrored(x0 + j + k % WINDOW - reach, width);
                if (limited.data[(size_t)r * width + q] > 0.f) mean = NAN;
            }
            grain_out.data[(size_t)y * width + x0 + j] = mean;
        }
    }
}
