// Semi-global matching on a CPU.
#pragma once
#include "lfgpu.h"

// Follow the blocks of paths from `first` to before `last` in the direction (dy, dx).
//
// Paths that lie side by side are followed together, pixel by pixel. A path has cost nothing before it begins: then the
// formula of its further pixels gives the first one's costs as they are.
void follow_blocks(
    Array3<float> volume, Array2<Pixel> image, Array2<float> scale, Number small, Number large, float contrast, int dy,
    int dx, bool adds, int first, int last, Array1<float> room, Array3<float> sum_out) {
    // What a change by one, and by more, costs between two pixels.
    auto step_costs = [&](int p, int q, float& small_out, float& large_out) {
        float difference = 0.f;
        for (int c = 0; c < CHANNELS; ++c) difference += fabsf(image.data[p].c[c] - image.data[q].c[c]);
        const float likeness = expf(-difference / (CHANNELS * contrast));
        small_out = scale.data[p] * small * (likeness > 0.2f ? likeness : 0.2f);
        large_out = scale.data[p] * (large * likeness > 1.2f * small ? large * likeness : 1.2f * small);
    };

    // A square of numbers is turned in registers: its halves are merged row by row, as often as it can be halved.
    typedef float Row __attribute__((ext_vector_type(CHUNK)));
    struct Square {
        Row rows[CHUNK];
    };
    auto square_at = [](const float* corner, size_t stride) {
        Square found;
        for (int k = 0; k < CHUNK; ++k) __builtin_memcpy(&found.rows[k], corner + k * stride, sizeof(Row));
        return found;
    };
    auto put = [](const Square& square, float* corner, size_t stride) {
        for (int k = 0; k < CHUNK; ++k) __builtin_memcpy(corner + k * stride, &square.rows[k], sizeof(Row));
    };
    auto turn = [](Square square) {
        #pragma unroll
        for (int half = 1; half < CHUNK; half *= 2) {
            Square merged;
            #pragma unroll
            for (int k = 0; k < CHUNK / 2; ++k) {
                const Row upper = square.rows[k], lower = square.rows[k + CHUNK / 2];
                merged.rows[2 * k] = __builtin_shufflevector(upper, lower, LEFT);
                merged.rows[2 * k + 1] = __builtin_shufflevector(upper, lower, RIGHT);
            }
            square = merged;
        }
        return square;
    };

    const int count = volume.shape[0], height = volume.shape[1], width = volume.shape[2];
    const size_t size = (size_t)height * width;
    float* const before = room.data;  // what the paths cost up to the pixels before, [count + 1][BLOCK]
    float* const turned = before + (count + 1) * BLOCK;  // [count][CHUNK][BLOCK]
    float least[BLOCK], smalls[BLOCK], larges[BLOCK];

    // One pixel further for paths begin to end: `costs` and `to` have a slice every `stride` numbers.
    auto advance = [&](const float* costs, float* to, size_t stride, bool adds, int begin, int end) {
        float low[BLOCK], least_now[BLOCK];
        for (int j = begin; j < end; ++j) {
            low[j] = INFINITY;
            least_now[j] = INFINITY;
            larges[j] += least[j];
        }
        for (int l = 0; l < count; ++l) {
            float* const b = before + l * BLOCK;
            const float* const c = costs + l * stride;
            float* const sum = to + l * stride;
            #pragma clang loop vectorize(assume_safety)
            for (int j = begin; j < end; ++j) {
                const float here = b[j], high = b[j + BLOCK];
                const float one = (low[j] < high ? low[j] : high) + smalls[j];
                const float change = one < larges[j] ? one : larges[j];
                const float cost = c[j] + ((here < change ? here : change) - least[j]);
                low[j] = here;
                b[j] = cost;
                least_now[j] = cost < least_now[j] ? cost : least_now[j];
                sum[j] = adds ? sum[j] + cost : cost;
            }
        }
        for (int j = begin; j < end; ++j) least[j] = least_now[j];
    };

    for (int block = first; block < last; ++block) {
        for (int i = 0; i < count * BLOCK; ++i) before[i] = 0.f;
        for (int j = 0; j < BLOCK; ++j) {
            before[count * BLOCK + j] = INFINITY;
            least[j] = 0.f;
        }
        if (dy != 0) {
            for (int i = 0; i < height; ++i) {
                const int y = dy > 0 ? i : height - 1 - i;
                // Where the first path of the block is, in the frame or not: no path comes back once it has left.
                const int x0 = block * BLOCK + dx * i - (dx > 0 ? height - 1 : 0);
                const int begin = x0 < 0 ? -x0 : 0, end = width - x0 < BLOCK ? width - x0 : BLOCK;
                for (int j = begin; j < end; ++j) {
                    const int x = x0 + j, p = y * width + x;
                    smalls[j] = larges[j] = 0.f;
                    if (i > 0 && x - dx >= 0 && x - dx < width)
                        step_costs(p, p - dy * width - dx, smalls[j], larges[j]);
                }
                const long long place = (long long)y * width + x0;
                if (begin == 0 && end == BLOCK)
                    advance(volume.data + place, sum_out.data + place, size, adds, 0, BLOCK);
                else if (begin < end)
                    advance(volume.data + place, sum_out.data + place, size, adds, begin, end);
            }
            continue;
        }
        const int y0 = block * BLOCK, rows = height - y0 < BLOCK ? height - y0 : BLOCK;
        for (int done = 0; done < width; done += CHUNK) {
            const int columns = width - done < CHUNK ? width - done : CHUNK;
            const int x0 = dx > 0 ? done : width - done - columns;
            const size_t corner = (size_t)y0 * width + x0;
            const bool whole = rows == BLOCK && columns == CHUNK;
            for (int l = 0; l < count; ++l)
                if (whole)
                    for (int j = 0; j < BLOCK; j += CHUNK) {
                        const float* const costs = volume.data + l * size + corner + j * width;
                        put(turn(square_at(costs, width)), turned + l * CHUNK * BLOCK + j, BLOCK);
                    }
                else
                    for (int j = 0; j < rows; ++j)
                        for (int i = 0; i < columns; ++i)
                            turned[(l * CHUNK + i) * BLOCK + j] = volume.data[l * size + corner + j * width + i];
            for (int k = 0; k < columns; ++k) {
                const int i = dx > 0 ? k : columns - 1 - k;
                for (int j = 0; j < rows; ++j) {
                    const int p = (y0 + j) * width + x0 + i;
                    smalls[j] = larges[j] = 0.f;
                    if (done + k > 0) step_costs(p, p - dx, smalls[j], larges[j]);
                }
                float* const column = turned + i * BLOCK;
                if (rows == BLOCK)
                    advance(column, column, CHUNK * BLOCK, false, 0, BLOCK);
                else
                    advance(column, column, CHUNK * BLOCK, false, 0, rows);
            }
            for (int l = 0; l < count; ++l)
                if (whole)
                    for (int j = 0; j < BLOCK; j += CHUNK) {
                        float* const sums = sum_out.data + l * size + corner + j * width;
                        Square square = turn(square_at(turned + l * CHUNK * BLOCK + j, BLOCK));
                        if (adds) {
                            const Square before = square_at(sums, width);
                            for (int k = 0; k < CHUNK; ++k) square.rows[k] += before.rows[k];
                        }
                        put(square, sums, width);
                    }
                else
                    for (int j = 0; j < rows; ++j) {
                        float* const sum = sum_out.data + l * size + corner + j * width;
                        for (int i = 0; i < columns; ++i)
                            sum[i] = (adds ? sum[i] : 0.f) + turned[(l * CHUNK + i) * BLOCK + j];
                    }
        }
    }
}
