// Convolutions of volumes on a GPU: by its tensor cores where volumes are in half precision, else number by number.
//
// Tensor cores multiply matrices that are spread over the lanes of a warp: with row = lane / 4 and pair = 2 (lane % 4),
// 16 x 8 sums have two neighbours at (row, pair) and two at (row + 8, pair) in each lane. 16 x 16 factors a have pairs
// at (row, pair), (row + 8, pair), (row, pair + 8) and (row + 8, pair + 8), and 16 x 8 factors b, which are weights, at
// (pair, row) and (pair + 8, row). Rows are pixels, columns channels of the output.
#pragma once
#include "lfgpu.h"

// The place of a row in a volume that holds so many. Where these are all, nothing is divided.
inline int place_of(int y, int held) {
    return y < held ? y : y % held;
}

// Add a b for 16 channels of the volume, or for the first 8 where these are not `both` blocks.
inline void add_products(float* sums, const unsigned* a, unsigned b0, unsigned b1, bool both) {
    if (both)
        asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
            "{%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, {%0,%1,%2,%3};"
            : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
    else
        asm volatile("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 "
            "{%0,%1,%2,%3}, {%4,%5}, {%6}, {%0,%1,%2,%3};"
            : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
            : "r"(a[0]), "r"(a[1]), "r"(b0));
}

// Load factors a: the first 16 lanes have the places of the pixels, the others those of the same pixels 8 channels on,
// which are loaded if there are `both` blocks.
inline void load_factors(unsigned* a, const unsigned* from, bool both) {
    if (both)
        asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0,%1,%2,%3}, [%4];"
            : "=r"(a[0]), "=r"(a[1]), "=r"(a[2]), "=r"(a[3]) : "l"(__cvta_generic_to_shared(from)));
    else
        asm volatile("ldmatrix.sync.aligned.m8n8.x2.shared.b16 {%0,%1}, [%2];"
            : "=r"(a[0]), "=r"(a[1]) : "l"(__cvta_generic_to_shared(from)));
}

// Begin to copy 16 bytes to shared memory, or zeros if these bytes are not `there`; nothing is read then.
inline void begin_copy(unsigned* to, const uint4* from, bool there) {
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;"
        :: "l"(__cvta_generic_to_shared(to)), "l"(from), "r"(there ? 16 : 0) : "memory");
}

// Wait for the copies that this thread has begun.
inline void end_copies() {
    asm volatile("cp.async.wait_all;" ::: "memory");
}

// Compute 16 columns and 4 TILES of `some` rows from `first` on with each block of four warps; each warp has TILES of
// the rows. The volume has so much `height`; a row of `added` is for `high` rows.
//
// What they need of a slice of the volume lies in shared memory, APART numbers from pixel to pixel: eight pixels are in
// different banks then. A tap reads each SXth column, so columns x with the same x % SX lie together. A line is read
// once for all taps in a column of the window. The next slice is copied while one is multiplied if both have room in
// SHARED bytes. Weights are in the order of the lanes: [tap, block of 8 channels, block of 8 outputs, lane]. Two blocks
// of outputs are 16 channels, of which each lane has four next to each other, which it writes at once.
//
// Where windows are pixels, nothing is shared: each lane reads four of 16 channels of the volume at once, too.
void convolve_tiles(
    int tid, Array3<In> volume, Array1<uint32> weights, Array1<float> bias, Array3<Added> added, int first, int some,
    int height, int high, Array3<Out> volume_out) {
    constexpr int ROWS = 4 * TILES, HIGH = (ROWS - 1) * SY + KY, WIDE = 15 * SX + KX;
    constexpr int EACH = 15 + (KX + SX - 1) / SX, LINE = SX * EACH;
    constexpr int BLOCKS = CI / 8, PARTS = (CO + 7) / 8, WORDS = APART / 2;
    constexpr int BUFFERS = KL > 1 && 2 * HIGH * LINE * WORDS * 4 <= SHARED ? 2 : 1;
    constexpr bool DIRECT = KL * KY * KX == 1;
    alignas(16) __shared__ unsigned tile[DIRECT ? 4 : BUFFERS * HIGH * LINE * WORDS];
    const int labels = volume.shape[0], held = volume.shape[1], width = volume.shape[2];
    const int rows = volume_out.shape[1], columns = volume_out.shape[2];
    const int lane = tid % 32, warp = tid % 128 / 32, row = lane / 4, pair = lane % 4;
    const int across = (columns + 15) / 16, down = (some + ROWS - 1) / ROWS, block = tid / 128;
    const int l = block / (across * down), place = block - l * across * down;
    const int top = first + place / across * ROWS, left = place % across * 16;
    const int lowest = l * SL - KL / 2, begin = max(0, -lowest), end = min(KL, labels - lowest);

    float sums[TILES][PARTS][4];
    #pragma unroll
    for (int j = 0; j < TILES; ++j)
        #pragma unroll
        for (int n = 0; n < PARTS; ++n)
            #pragma unroll
            for (int i = 0; i < 4; ++i)
                sums[j][n][i] = bias.data[n / 2 * 16 + ((n | 1) < PARTS ? 4 * pair + n % 2 * 2 : 2 * pair) + i % 2];
    auto begin_slice = [&](int kl) {
        #pragma unroll 1
        for (int line = warp; line < HIGH; line += 4) {
            const int y = top * SY - KY / 2 + line, before = (left * SX - KX / 2) * BLOCKS;
            const bool inside = y >= 0 && y < height;
            const size_t along = ((size_t)(lowest + kl) * held + (inside ? place_of(y, held) : 0)) * width * BLOCKS;
            const uint4* const from = (const uint4*)volume.data + along;
            unsigned* const to = tile + (kl % BUFFERS * HIGH + line) * LINE * WORDS;
            #pragma unroll
            for (int part = 0; part < WIDE * BLOCKS; part += 32) {
                const int i = part + lane, x = before + i;
                if (i >= WIDE * BLOCKS) break;
                const int place = i / BLOCKS % SX * EACH + i / BLOCKS / SX;
                begin_copy(to + place * WORDS + i % BLOCKS * 4, from + x, inside && x >= 0 && x < width * BLOCKS);
            }
        }
    };
    #pragma unroll
    for (int b = 0; DIRECT && b < BLOCKS; b += 2) {
        const bool both = b + 1 < BLOCKS;
        uint2 upper[TILES], lower[TILES];
        #pragma unroll
        for (int j = 0; j < TILES; ++j) {
            const int y = min(top + warp * TILES + j, first + some - 1) * SY, x = min(left + row, columns - 1) * SX;
            const unsigned* const from = (const unsigned*)volume.data + b * 4
                + (((size_t)l * SL * held + place_of(y, held)) * width + x) * (CI / 2);
            const int below = (min(left + row + 8, columns - 1) * SX - x) * (CI / 2);
            if (both) {
                upper[j] = __ldg((const uint2*)from + pair);
                lower[j] = __ldg((const uint2*)(from + below) + pair);
            } else {
                upper[j].x = __ldg(from + pair);
                lower[j].x = __ldg(from + below + pair);
            }
        }
        #pragma unroll
        for (int n = 0; n < PARTS; ++n) {
            const unsigned* const weight = weights.data + (b * PARTS + n) * 32 + lane;
            const unsigned first = __ldg(weight), second = both ? __ldg(weight + PARTS * 32) : 0u;
            #pragma unroll
            for (int j = 0; j < TILES; ++j) {
                const unsigned a[4] = {upper[j].x, lower[j].x, upper[j].y, lower[j].y};
                add_products(sums[j][n], a, first, second, both);
            }
        }
    }
    for (int kl = begin; !DIRECT && kl < end; ++kl) {
        if (BUFFERS == 1 || kl == begin) {
            __syncthreads();
            begin_slice(kl);
        }
        end_copies();
        __syncthreads();
        if (BUFFERS > 1 && kl + 1 < end) begin_slice(kl + 1);
        const unsigned* const slice = tile + kl % BUFFERS * HIGH * LINE * WORDS;
        for (int kx = 0; kx < KX; ++kx) {
            const unsigned* const here =
                slice + (warp * TILES * SY * LINE + kx % SX * EACH + kx / SX + lane % 16) * WORDS + lane / 16 * 4;
            #pragma unroll
            for (int b = 0; b < BLOCKS; b += 2) {
                const bool both = b + 1 < BLOCKS;
                unsigned first[KY][PARTS], second[KY][PARTS];
                #pragma unroll
                for (int ky = 0; ky < KY; ++ky)
                    #pragma unroll
                    for (int n = 0; n < PARTS; ++n) {
                        const int block = ((kl * KY + ky) * KX + kx) * BLOCKS + b;
                        const unsigned* const weight = weights.data + (block * PARTS + n) * 32 + lane;
                        first[ky][n] = __ldg(weight);
                        second[ky][n] = both ? __ldg(weight + PARTS * 32) : 0u;
                    }
                #pragma unroll
                for (int line = 0; line < (TILES - 1) * SY + KY; ++line) {
                    unsigned a[4];
                    load_factors(a, here + line * LINE * WORDS + b * 4, both);
                    #pragma unroll
                    for (int ky = line % SY; ky < KY; ky += SY) {
                        const int j = (line - ky) / SY;
                        if (line < ky || j >= TILES) continue;
                        #pragma unroll
                        for (int n = 0; n < PARTS; ++n) add_products(sums[j][n], a, first[ky][n], second[ky][n], both);
                    }
                }
            }
        }
    }

    struct alignas(2 * sizeof(RESULT)) Pair { RESULT values[2]; };
    struct alignas(4 * sizeof(RESULT)) Four { RESULT values[4]; };
    const STORED* const more = (const STORED*)added.data;
    const int deep = more ? volume_out.shape[0] / added.shape[0] : 1, apart = more ? columns / added.shape[2] : 1;
    const int beside[2] = {(left + row) / apart, (left + row + 8) / apart};
    #pragma unroll
    for (int j = 0; j < TILES; ++j) {
        const int y = top + warp * TILES + j;
        if (y >= first + some) continue;
        const size_t line = ((size_t)l * rows + place_of(y, rows)) * columns;
        const int high_line = more ? place_of(y / high, added.shape[1]) : 0;
        const size_t repeated = more ? ((size_t)(l / deep) * added.shape[1] + high_line) * added.shape[2] : 0;
        #pragma unroll
        for (int i = 0; i < 2; ++i) {
            const int x = left + row + 8 * i;
            if (x >= columns) continue;
            #pragma unroll
            for (int n = 0; n < PARTS; n += 2) {
                const int count = n + 1 < PARTS ? 4 : 2, c = 8 * n + count * pair;
                if (c >= CO) continue;
                const STORED* const other = more + (more ? (repeated + beside[i]) * CO + c : 0);
                uint2 words = {0u, 0u};
                if (more && count == 4) words = __ldg((const uint2*)other);
                if (more && count == 2) words.x = __ldg((const unsigned*)other);
                STORED others[4];
                memcpy(others, &words, sizeof(words));
                RESULT results[4];
                #pragma unroll
                for (int k = 0; k < count; ++k) {
                    float sum = sums[j][n + k / 2][2 * i + k % 2];
                    if (more) sum += (float)others[k];
                    results[k] = (RESULT)(RECTIFIED ? fmaxf(sum, 0.f) : sum);
                }
                RESULT* const out = (RESULT*)volume_out.data + (line + x) * CO + c;
                if (count == 4)
                    *(Four*)out = Four{results[0], results[1], results[2], results[3]};
                else
                    *(Pair*)out = Pair{results[0], results[1]};
            }
        }
    }
}

// Compute four channels of a voxel with each thread; weights are [KL, KY, KX, CI, PADDED].
void convolve_voxels(
    int tid, Array3<In> volume, Array1<float> weights, Array1<float> bias, Array3<Added> added, int first, int some,
    int height, int high, Array3<Out> volume_out) {
    constexpr int GROUPS = CO / 4;
    const int labels = volume.shape[0], held = volume.shape[1], width = volume.shape[2];
    const int rows = volume_out.shape[1], columns = volume_out.shape[2];
    const int voxel = tid / GROUPS, c = tid % GROUPS * 4;
    if (voxel >= volume_out.shape[0] * some * columns) return;
    const int x = voxel % columns, y = first + voxel / columns % some, l = voxel / columns / some;
    const STORED* const from = (const STORED*)volume.data;
    float sums[4];
    for (int i = 0; i < 4; ++i) sums[i] = bias.data[c + i];
    for (int k = 0; k < KL * KY * KX; ++k) {
        const int tl = l * SL + k / KX / KY - KL / 2, ty = y * SY + k / KX % KY - KY / 2, tx = x * SX + k % KX - KX / 2;
        if (tl < 0 || tl >= labels || ty < 0 || ty >= height || tx < 0 || tx >= width) continue;
        const STORED* const here = from + (((size_t)tl * held + place_of(ty, held)) * width + tx) * CI;
        const float* const weight = weights.data + k * CI * PADDED + c;
        for (int j = 0; j < CI; ++j) {
            const float value = (float)here[j];
            for (int i = 0; i < 4; ++i) sums[i] += value * weight[j * PADDED + i];
        }
    }
    if (added.data) {
        const int ml = l / (volume_out.shape[0] / added.shape[0]), my = place_of(y / high, added.shape[1]);
        const int mx = x / (columns / added.shape[2]);
        const STORED* const other =
            (const STORED*)added.data + (((size_t)ml * added.shape[1] + my) * added.shape[2] + mx) * CO + c;
        for (int i = 0; i < 4; ++i) sums[i] += (float)other[i];
    }
    const size_t line = (size_t)l * rows + place_of(y, rows);
    RESULT* const out = (RESULT*)volume_out.data + (line * columns + x) * CO + c;
    for (int i = 0; i < 4; ++i) out[i] = (RESULT)(RECTIFIED ? fmaxf(sums[i], 0.f) : sums[i]);
}
