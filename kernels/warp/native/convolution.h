// Convolutions of volumes on a CPU.
//
// A thread computes some rows, one or two vectors of channels of some pixels at a time: their sums stay in registers,
// so that each weight that is read serves all of these pixels. What a few rows need of the volume is copied first, as
// floats and with zeros beyond the border.
//
// Where a window has three taps along a row, a group of MANY pixels is four, which take six products instead of twelve:
// sums of the volume (BEFORE) times sums of the weights, and sums of these (AFTER), as Winograd found.
#pragma once
#include "lfgpu.h"

// Compute some of the rows [l, y]: of these, in which y is one of `some` from `top` on, those from `first` to before
// `last`. The volume has so much `height`; a row of `added` is for `high` rows. Weights are [TERMS, l, y, TAPS, inputs,
// padded outputs]. `plan` has the window along l and y, the strides along these, the number of padded outputs, and
// whether results are rectified. Channels are multiples of four.
void convolve_rows(
    Array4<Stored> volume, Array1<float> weights, Array1<float> bias, Array4<Stored> added, Array1<int> plan, int top,
    int some, int height, int high, int first, int last, Array1<float> room, Array4<Result> volume_out) {
#ifdef __AVX512F__
    constexpr int LANES = 16, MOST = 2;  // vectors of channels at a time
#else
    constexpr int LANES = 8, MOST = 1;
#endif
    constexpr bool PLAIN = TERMS == 1;
    constexpr int GROUPS = PIXELS / MANY, WINDOW = (MANY - 1) * SX + KX;
    constexpr float before[TERMS][WINDOW] = {BEFORE}, after[MANY][TERMS] = {AFTER};
    typedef float Lanes __attribute__((vector_size(4 * LANES)));
    typedef float Read __attribute__((vector_size(4 * LANES), aligned(4)));

    const int deep = plan.data[0], tall = plan.data[1], slice = plan.data[2], down = plan.data[3];
    const int padded = plan.data[4];
    const float least = plan.data[5] ? 0.f : -__builtin_inff();
    const int labels = volume.shape[0], held = volume.shape[1], width = volume.shape[2], inputs = volume.shape[3];
    const int rows = volume_out.shape[1], columns = volume_out.shape[2], outputs = volume_out.shape[3];
    const STORED* const from = (const STORED*)volume.data;
    const STORED* const more = (const STORED*)added.data;
    RESULT* const to = (RESULT*)volume_out.data;
    const int slices = more ? volume_out.shape[0] / added.shape[0] : 1, apart = more ? columns / added.shape[2] : 1;
    const int reach = (ROWS - 1) * down + tall, lines = deep * reach;  // of the volume, which ROWS rows share
    const int needed = ((PIXELS - 1) * SX + KX) * inputs;  // of each of these
    const int size = PLAIN ? needed : GROUPS * inputs, between = PLAIN ? SX * inputs : inputs;  // of copies, of groups
    float* const line = room.data;
    float* const copies = line + needed;
    Lanes one[8][MANY][1], several[PLAIN ? 8 : 8 / MOST][MANY][MOST];

    // Compute the groups from `group` on of the r-th row, and the vectors of channels from `v` on.
    auto compute = [&](auto& results, int l, int y, int x, int r, int group, int v) {
        constexpr int SOME = sizeof(results) / sizeof(results[0]), PARTS = sizeof(results[0][0]) / sizeof(Lanes);
        for (int j = 0; j < SOME * MANY; ++j)
            for (int p = 0; p < PARTS; ++p)
                results[j / MANY][j % MANY][p] = *(const Read*)(bias.data + (v + p) * LANES);
        const float* weight = weights.data + v * LANES;
        #pragma unroll
        for (int t = 0; t < TERMS; ++t) {
            Lanes sums[SOME][PARTS];
            #pragma unroll
            for (int j = 0; j < SOME; ++j)
                #pragma unroll
                for (int p = 0; p < PARTS; ++p) sums[j][p] = Lanes{};
            for (int k = 0; k < deep * tall; ++k) {
                const int place = t * lines + k / tall * reach + r * down + k % tall;
                const float* copy = copies + (size_t)place * size + group * between;
                for (int i = 0; i < TAPS * inputs; ++i, ++copy, weight += padded)
                    #pragma unroll
                    for (int j = 0; j < SOME; ++j)
                        #pragma unroll
                        for (int p = 0; p < PARTS; ++p)
                            sums[j][p] += *(const Read*)(weight + p * LANES) * copy[j * between];
            }
            #pragma unroll
            for (int j = 0; j < SOME; ++j)
                #pragma unroll
                for (int m = 0; m < MANY; ++m)
                    #pragma unroll
                    for (int p = 0; p < PARTS; ++p)
                        if (after[m][t] != 0.f) results[j][m][p] += after[m][t] * sums[j][p];
        }

        const int other_row = more ? l / slices * added.shape[1] + y / high % added.shape[1] : 0;
        const int begin = v * LANES, channels = wp::min(PARTS * LANES, outputs - begin);
        for (int j = 0; j < SOME * MANY && x + j < columns; ++j) {
            float* const result = (float*)results[j / MANY][j % MANY];
            if (more) {
                const int other = other_row * added.shape[2] + (x + j) / apart;
                #pragma clang loop vectorize_predicate(enable)
                for (int c = 0; c < channels; ++c) result[c] += (float)more[(size_t)other * outputs + begin + c];
            }
            RESULT done[PARTS * LANES];
            for (int c = 0; c < PARTS * LANES; ++c) done[c] = (RESULT)(result[c] < least ? least : result[c]);
            RESULT* const out = to + (((size_t)l * rows + y % rows) * columns + x + j) * outputs + begin;
            int c = 0;
            for (; c + LANES <= channels; c += LANES) __builtin_memcpy(out + c, done + c, LANES * sizeof(RESULT));
            for (; c < channels; c += 4) __builtin_memcpy(out + c, done + c, 4 * sizeof(RESULT));
        }
    };

    for (int row = first, next; row < last; row = next) {
        const int l = row / some, y = top + row - l * some;
        next = wp::min(wp::min(row + ROWS, (l + 1) * some), last);
        for (int x = 0; x < columns; x += PIXELS) {
            const int left = x * SX - KX / 2;  // the first pixel that is needed
            const int begin = left < 0 ? -left * inputs : 0, end = wp::min((width - left) * inputs, needed);
            for (int k = 0; k < lines; ++k) {
                const int tl = l * slice + k / reach - deep / 2, ty = y * down + k % reach - tall / 2;
                const bool inside = tl >= 0 && tl < labels && ty >= 0 && ty < height;
                const STORED* const source = from + (((long long)tl * held + ty % held) * width + left) * inputs;
                float* const copy = PLAIN ? copies + (size_t)k * size : line;
                for (int i = 0; i < begin; ++i) copy[i] = 0.f;
                for (int i = begin; inside && i < end; ++i) copy[i] = (float)source[i];
                for (int i = inside ? end : begin; i < needed; ++i) copy[i] = 0.f;
                for (int j = 0; !PLAIN && j < GROUPS; ++j)
                    #pragma clang loop vectorize(assume_safety)
                    for (int i = 0; i < inputs; ++i)
                        #pragma unroll
                        for (int t = 0; t < TERMS; ++t) {
                            float sum = 0.f;
                            #pragma unroll
                            for (int w = 0; w < WINDOW; ++w)
                                if (before[t][w] != 0.f) sum += before[t][w] * line[(j * MANY * SX + w) * inputs + i];
                            copies[((size_t)t * lines + k) * size + j * inputs + i] = sum;
                        }
            }
            for (int v = 0; v * LANES < outputs; v += MOST) {
                const bool alone = MOST == 1 || (v + 1) * LANES >= outputs;
                const int at_once = alone ? 8 : sizeof(several) / sizeof(several[0]);
                for (int r = 0; r < next - row; ++r)
                    for (int j = 0; j < GROUPS && x + j * MANY < columns; j += at_once)
                        if (alone)
                            compute(one, l, y + r, x + j * MANY, r, j, v);
                        else
                            compute(several, l, y + r, x + j * MANY, r, j, v);
            }
        }
    }
}
