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

// Add a b for 16 channels of the volume.
inline void add_products(float* sums, const unsigned* a, unsigned b0, unsigned b1) {
    asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
        "{%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, {%0,%1,%2,%3};"
        : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
        : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
}

// The same for 8 channels.
inline void add_half_products(float* sums, const unsigned* a, unsigned b0) {
    asm volatile("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 "
        "{%0,%1,%2,%3}, {%4,%5}, {%6}, {%0,%1,%2,%3};"
        : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
        : "r"(a[0]), "r"(a[1]), "r"(b0));
}

// Load factors a of 16 channels; lane % 16 has the place of a pixel, half of the lanes that of its last 8 channels.
inline void load_factors(unsigned* a, const unsigned* from) {
    asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0,%1,%2,%3}, [%4];"
        : "=r"(a[0]), "=r"(a[1]), "=r"(a[2]), "=r"(a[3]) : "l"(__cvta_generic_to_shared(from)));
}

// The same for 8 channels; the places of 16 lanes count.
inline void load_half_factors(unsigned* a, const unsigned* from) {
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
// once for all taps that it has a part in. The next slice is copied while one is multiplied if both have room in SHARED
// bytes. Weights are in the order of the lanes: [tap, block of 8 channels, block of 8 outputs, lane].
void convolve_tiles(
    int tid, Array3<In> volume, Array1<uint32> weights, Array1<float> bias, Array3<Added> added, int first, int some,
    int height, int high, Array3<Out> volume_out) {
    constexpr int ROWS = 4 * TILES, HIGH = (ROWS - 1) * SY + KY, WIDE = 15 * SX + KX;
    constexpr int EACH = 15 + (KX + SX - 1) / SX, LINE = SX * EACH;
    constexpr int BLOCKS = CI / 8, PARTS = (CO + 7) / 8, WORDS = APART / 2;
    constexpr int BUFFERS = KL > 1 && 2 * HIGH * LINE * WORDS * 4 <= SHARED ? 2 : 1;
    alignas(16) __shared__ unsigned tile[BUFFERS * HIGH * LINE * WORDS];
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
            for (int i = 0; i < 4; ++i) sums[j][n][i] = 0.f;
    auto begin_slice = [&](int kl) {
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
    for (int kl = begin; kl < end; ++kl) {
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
                unsigned first[KY][PARTS], second[KY][PARTS];
                #pragma unroll
                for (int ky = 0; ky < KY; ++ky)
                    #pragma unroll
                    for (int n = 0; n < PARTS; ++n) {
                        const int block = ((kl * KY + ky) * KX + kx) * BLOCKS + b;
                        first[ky][n] = __ldg(weights.data + (block * PARTS + n) * 32 + lane);
                        if (b + 1 < BLOCKS) second[ky][n] = __ldg(weights.data + ((block + 1) * PARTS + n) * 32 + lane);
                    }
                #pragma unroll
                for (int line = 0; line < (TILES - 1) * SY + KY; ++line) {
                    unsigned a[4];
                    if (b + 1 < BLOCKS)
                        load_factors(a, here + line * LINE * WORDS + b * 4);
                    else
                        load_half_factors(a, here + line * LINE * WORDS + b * 4);
                    #pragma unroll
                    for (int ky = line % SY; ky < KY; ky += SY) {
                        const int j = (line - ky) / SY;
                        if (line < ky || j >= TILES) continue;
                        #pragma unroll
                        for (int n = 0; n < PARTS; ++n)
                            if (b + 1 < BLOCKS)
                                add_products(sums[j][n], a, first[ky][n], second[ky][n]);
                            else
                                add_half_products(sums[j][n], a, first[ky][n]);
                    }
                }
            }
        }
    }

    struct alignas(2 * sizeof(RESULT)) Pair { RESULT first, second; };
    const STORED* const more = (const STORED*)added.data;
    const int deep = more ? volume_out.shape[0] / added.shape[0] : 1, apart = more ? columns / added.shape[2] : 1;
    #pragma unroll
    for (int j = 0; j < TILES; ++j)
        #pragma unroll
        for (int i = 0; i < 2; ++i) {
            const int y = top + warp * TILES + j, x = left + row + 8 * i;
            if (y >= first + some || x >= columns) continue;
            RESULT* const out = (RESULT*)volume_out.data + (((size_t)l * rows + place_of(y, rows)) * columns + x) * CO;
            const int line = more ? place_of(y / high, added.shape[1]) : 0;
            const size_t repeated = more ? ((size_t)(l / deep) * added.shape[1] + line) * added.shape[2] : 0;
            const STORED* const other = more + (more ? (repeated + x / apart) * CO : 0);
            #pragma unroll
            for (int n = 0; n < PARTS; ++n) {
                const int c = 8 * n + 2 * pair;
                if (c >= CO) continue;
                float a = sums[j][n][2 * i] + bias.data[c], b = sums[j][n][2 * i + 1] + bias.data[c + 1];
                if (more) {
                    a += (float)other[c];
                    b += (float)other[c + 1];
                }
                if (RECTIFIED) {
                    a = fmaxf(a, 0.f);
                    b = fmaxf(b, 0.f);
                }
                *(Pair*)(out + c) = Pair{(RESULT)a, (RESULT)b};
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
