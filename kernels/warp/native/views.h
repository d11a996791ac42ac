// Lines of views, and local contrast normalisation in four passes.
//
// The Gaussian is a part of the code: Warp's own loops over neighbours take several times as long. A thread has some
// pixels in line with the Gaussian at once, so that it reads what lies under it once for all of them; of a row it has
// every lanes-th, from `lane` on.
#pragma once
#include "lfgpu.h"

// Copy a row of the EPIs of a line of views; Warp's own indices have 64 bits, and take a GPU longer than the memory.
void copy_line(
    int tid, Array3<Stored> views, Array1<int> line, int vertical, int top, int left, int row, int lanes,
    Array3<Stored> epis_out) {
    const int y = row + tid / lanes, lane = tid % lanes;
    const int rows = views.shape[1], columns = views.shape[2], height = epis_out.shape[1], width = epis_out.shape[2];
    for (int x = lane; x < width; x += lanes) {
        const size_t from = (size_t)(top + (vertical ? x : y)) * columns + left + (vertical ? y : x);
        const auto* const in = views.data + from;
        auto* const out = epis_out.data + (size_t)y * width + x;
        #pragma unroll 4
        for (int u = 0; u < line.shape[0]; ++u)
            out[(size_t)u * height * width] = in[(size_t)line.data[u] * rows * columns];
    }
}

// The index that `i` is mirrored to, at the ends of a line of pixels.
inline int mirrored(int i, int size) {
    if ((unsigned)i < (unsigned)size) return i;
    i %= 2 * size;
    if (i < 0) i += 2 * size;
    return i < size ? i : 2 * size - 1 - i;
}

// Gaussian sums along rows, and how much of the Gaussian lay on valid pixels.
void add_rows(
    int tid, Array3<Stored> views, Array3<float> valid, float scale, int lanes, Array3<Pixel> sums_out,
    Array3<float> shares_out) {
    const int lane = tid % lanes, n = tid / lanes / views.shape[1], y = tid / lanes - n * views.shape[1];
    constexpr float w[] = {GAUSSIAN};
    constexpr int taps = sizeof(w) / sizeof(float), radius = taps / 2;
    const int height = views.shape[1], width = views.shape[2];
    const size_t row = ((size_t)n * height + y) * width;
    const auto* __restrict__ const in = views.data + row;
    const float* __restrict__ const mask = valid.data ? valid.data + row : nullptr;
    for (int x = AT_ONCE * lane; x < width; x += AT_ONCE * lanes) {
        const bool inner = x >= radius && x + AT_ONCE <= width - radius;
        float total[AT_ONCE][CHANNELS] = {}, share[AT_ONCE] = {};
        #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? x + k - radius : mirrored(x + k - radius, width);
            if (mask && mask[i] == 0.f) continue;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                for (int c = 0; c < CHANNELS; ++c) total[j][c] += w[k - j] * (float)in[i].c[c];
                share[j] += w[k - j];
            }
        }
        for (int j = 0; j < AT_ONCE && x + j < width; ++j) {
            for (int c = 0; c < CHANNELS; ++c) sums_out.data[row + x + j].c[c] = scale * total[j][c];
            if (mask) shares_out.data[row + x + j] = share[j];
        }
    }
}

// Gaussian sums down columns; what the mean leaves, and its mean square over the channels.
void subtract_mean(
    int tid, Array3<Stored> views, Array3<Pixel> sums, Array3<float> shares, Array3<float> valid, float scale,
    int lanes, Array3<Pixel> details_out, Array3<Energy> energies_out) {
    const int lane = tid % lanes, down = (views.shape[1] + AT_ONCE - 1) / AT_ONCE;
    const int n = tid / lanes / down, y = (tid / lanes - n * down) * AT_ONCE;
    constexpr float w[] = {GAUSSIAN};
    constexpr int taps = sizeof(w) / sizeof(float), radius = taps / 2;
    const int height = views.shape[1], width = views.shape[2];
    const size_t first = (size_t)n * height * width;
    const bool inner = y >= radius && y + AT_ONCE <= height - radius;
    for (int x = lane; x < width; x += lanes) {
        float total[AT_ONCE][CHANNELS] = {}, share[AT_ONCE] = {};
        #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? y + k - radius : mirrored(y + k - radius, height);
            const size_t q = first + (size_t)i * width + x;
            const float counts = valid.data ? shares.data[q] : 1.f;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                for (int c = 0; c < CHANNELS; ++c) total[j][c] += w[k - j] * sums.data[q].c[c];
                share[j] += w[k - j] * counts;
            }
        }
        for (int j = 0; j < AT_ONCE && y + j < height; ++j) {
            const size_t q = first + (size_t)(y + j) * width + x;
            float energy = 0.f;
            for (int c = 0; c < CHANNELS; ++c) {
                float value = scale * (float)views.data[q].c[c];
                if (share[j] > LEAST) value -= total[j][c] / share[j];
                details_out.data[q].c[c] = value;
                energy += value * value;
            }
            energies_out.data[q].c[0] = energy / CHANNELS;
        }
    }
}

// Details in units of their contrast.
void divide_by_contrast(
    int tid, Array3<Pixel> details, Array3<Energy> sums, Array3<float> shares, Array3<float> valid, float floor,
    int lanes, Array3<Detail> detail_out) {
    const int lane = tid % lanes, down = (details.shape[1] + AT_ONCE - 1) / AT_ONCE;
    const int n = tid / lanes / down, y = (tid / lanes - n * down) * AT_ONCE;
    constexpr float w[] = {GAUSSIAN};
    constexpr int taps = sizeof(w) / sizeof(float), radius = taps / 2;
    const int height = details.shape[1], width = details.shape[2];
    const size_t first = (size_t)n * height * width;
    const bool inner = y >= radius && y + AT_ONCE <= height - radius;
    for (int x = lane; x < width; x += lanes) {
        float total[AT_ONCE] = {}, share[AT_ONCE] = {};
        #pragma unroll
        for (int k = 0; k < taps + AT_ONCE - 1; ++k) {
            const int i = inner ? y + k - radius : mirrored(y + k - radius, height);
            const size_t q = first + (size_t)i * width + x;
            const float counts = valid.data ? shares.data[q] : 1.f;
            for (int j = 0; j < AT_ONCE; ++j) {
                if (k < j || k - j >= taps) continue;
                total[j] += w[k - j] * sums.data[q].c[0];
                share[j] += w[k - j] * counts;
            }
        }
        for (int j = 0; j < AT_ONCE && y + j < height; ++j) {
            const size_t q = first + (size_t)(y + j) * width + x;
            const float energy = share[j] > LEAST ? total[j] / share[j] : 0.f;
            const float contrast = sqrtf(energy + floor * floor);
            for (int c = 0; c < CHANNELS; ++c) detail_out.data[q].c[c] = (DETAIL)(details.data[q].c[c] / contrast);
        }
    }
}
