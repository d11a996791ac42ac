// Semi-global matching on a GPU.
//
// A step along a path waits for the one before, whatever else a GPU could do meanwhile. So paths of several directions
// are followed at the same time, each direction with a volume of its own, which are added up in order. In these volumes
// [y, x, l] the costs of a pixel lie side by side: a warp, which has a path, reads and writes them as a whole.
#pragma once
#include "lfgpu.h"

// Follow a path with each warp, in the directions from `first` to before `last`.
//
// A thread has EACH neighbouring disparities. Threads tell each other the least cost and those at the ends of what they
// have. A diagonal that leaves the frame at one side goes on, as another path, at the other side of the next row: so
// all warps have the same work. What is needed AHEAD steps later is on its way from memory meanwhile.
void follow_path(int tid, Array3<float> volume, Array1<float> steps_to, int first, int last, Array1<float> room_out) {
    const int lane = tid % 32;
    int path = tid / 32;
    constexpr int downwards[] = {DOWNWARDS}, sideways[] = {SIDEWAYS};
    const int height = volume.shape[0], width = volume.shape[1], count = volume.shape[2];
    int direction = first;
    for (; direction + 1 < last; ++direction) {  // whose paths come one after the other
        const int paths = downwards[direction] ? width : height;
        if (path < paths) break;
        path -= paths;
    }
    const int dy = downwards[direction], dx = sideways[direction], steps = dy ? height : width, label = lane * EACH;
    if (path >= (dy ? width : height)) return;  // a whole warp, the last one
    const size_t size = (size_t)height * width * count;
    const float* const costs = volume.data + label;
    const float2* const penalties = (const float2*)steps_to.data + (size_t)direction * height * width;
    float* const to = room_out.data + (direction - first) * size + label;

    int x = dy ? path : (dx > 0 ? 0 : width - 1), p = (dy ? (dy > 0 ? 0 : height - 1) : path) * width + x;
    bool begins = true;
    float cost[AHEAD][EACH];
    float2 penalty[AHEAD];
    unsigned places[AHEAD];
    bool begin[AHEAD];
    auto fetch = [&](int slot) {
        const float* const from = costs + (size_t)(unsigned)p * count;
        #pragma unroll
        for (int k = 0; k < EACH; ++k) cost[slot][k] = label + k < count ? from[k] : INFINITY;
        penalty[slot] = penalties[(unsigned)p];
        places[slot] = p;
        begin[slot] = begins;
        x += dx;
        p += dy * width + dx;
        begins = dy && (x == width || x < 0);
        if (begins) {
            p -= dx * width;
            x = dx > 0 ? 0 : width - 1;
        }
    };
    #pragma unroll
    for (int slot = 0; slot < AHEAD; ++slot)
        if (slot < steps) fetch(slot);

    float before[EACH], least = 0.f, below = 0.f, above = 0.f;
    for (int base = 0; base < steps; base += AHEAD) {
        #pragma unroll
        for (int slot = 0; slot < AHEAD; ++slot) {
            if (base + slot >= steps) break;
            if (begin[slot]) {
                #pragma unroll
                for (int k = 0; k < EACH; ++k) before[k] = 0.f;
                least = below = above = 0.f;
            }
            const float one = penalty[slot].x, most = least + penalty[slot].y;
            float least_here = INFINITY, low = below;
            float* const out = to + (size_t)places[slot] * count;
            #pragma unroll
            for (int k = 0; k < EACH; ++k) {
                const float here = before[k], high = k + 1 < EACH ? before[k + 1] : above;
                const float change = fminf(fminf(low, high) + one, most);
                before[k] = cost[slot][k] + (fminf(here, change) - least);
                low = here;
                least_here = fminf(least_here, before[k]);
                if (label + k < count) out[k] = before[k];
            }
            if (base + slot + AHEAD < steps) fetch(slot);

            for (int far = 1; far < 32; far *= 2) least_here = fminf(least_here, __shfl_xor_sync(~0u, least_here, far));
            least = least_here;
            const float last_below = __shfl_up_sync(~0u, before[EACH - 1], 1);
            const float first_above = __shfl_down_sync(~0u, before[0], 1);
            below = lane > 0 ? last_below : INFINITY;
            above = lane < 31 ? first_above : INFINITY;
        }
    }
}

// What a change by one, and by more, costs at a pixel in all directions; nothing that begins a path changes.
void find_step_costs(
    int tid, Array2<Pixel> image, Array2<float> scale, Number small, Number large, float contrast, int width,
    Array1<float> steps_to_out) {
    constexpr int downwards[] = {DOWNWARDS}, sideways[] = {SIDEWAYS};
    const int height = image.shape[0], p = tid, y = p / width, x = p - y * width;
    const auto color = image.data[p];
    #pragma unroll
    for (int k = 0; k < 8; ++k) {
        const int row = y - downwards[k], column = x - sideways[k];
        float difference = 0.f;
        if ((unsigned)row < (unsigned)height && (unsigned)column < (unsigned)width) {
            const auto other = image.data[row * width + column];
            for (int c = 0; c < CHANNELS; ++c) difference += fabsf(color.c[c] - other.c[c]);
        }
        const float likeness = expf(-difference / (CHANNELS * contrast));
        float* const out = steps_to_out.data + 2 * ((size_t)k * height * width + p);
        out[0] = scale.data[p] * small * fmaxf(likeness, 0.2f);
        out[1] = scale.data[p] * fmaxf(large * likeness, 1.2f * small);
    }
}

// Turn a volume [l, y, x] into [y, x, l], or `volumes` of these into their sum, tile by tile.
//
// Sums are put together in the order in which one direction after the other would add to them.
void turn(int tid, Array3<float> volume, Array1<float> turned, int volumes, bool adds) {
    const int block = tid / TURNING, thread = tid - block * TURNING;
    __shared__ float tile[TILE][TILE + 1];
    const int count = volume.shape[0], height = volume.shape[1], width = volume.shape[2];
    const int columns = (width + TILE - 1) / TILE, parts = (count + TILE - 1) / TILE;
    const int y = block / (columns * parts), place = block - y * columns * parts;
    const int left = place / parts * TILE, first = place % parts * TILE;
    const size_t size = (size_t)height * width;
    float* const slices = volume.data + (size_t)y * width;
    const size_t row = ((size_t)y * width + left) * count + first;
    if (volumes == 0) {  // from slices
        for (int i = thread; i < TILE * TILE; i += TURNING) {
            const int l = i / TILE, x = i % TILE;
            if (first + l < count && left + x < width) tile[l][x] = slices[(first + l) * size + left + x];
        }
        __syncthreads();
        for (int i = thread; i < TILE * TILE; i += TURNING) {
            const int x = i / TILE, l = i % TILE;
            if (first + l < count && left + x < width) turned.data[row + (size_t)x * count + l] = tile[l][x];
        }
        return;
    }
    for (int i = thread; i < TILE * TILE; i += TURNING) {
        const int x = i / TILE, l = i % TILE;
        if (first + l >= count || left + x >= width) continue;
        const float* const costs = turned.data + row + (size_t)x * count + l;
        float sum = adds ? slices[(first + l) * size + left + x] : 0.f;
        #pragma unroll 8
        for (int k = 0; k < volumes; ++k) sum += costs[k * size * count];
        tile[l][x] = sum;
    }
    __syncthreads();
    for (int i = thread; i < TILE * TILE; i += TURNING) {
        const int l = i / TILE, x = i % TILE;
        if (first + l < count && left + x < width) slices[(first + l) * size + left + x] = tile[l][x];
    }
}
