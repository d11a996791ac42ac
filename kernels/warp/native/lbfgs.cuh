// The direction of L-BFGS on a GPU.
//
// All of it waits for memory more than it computes. So a thread asks for a pixel of many rows at once, the sums of the
// parts are fetched by as many threads as there are, and the recursion itself is one warp, a coefficient in each lane.
#pragma once
#include "lfgpu.h"

// Inner products of some rows with the new step, the new difference and the projected gradient, [part, row, 3].
void find_products(int tid, State state, Array3<float> stack, Array2<double> sums_out) {
    if (state.accepted.data[0] != 1) return;
    const int block = tid / BLOCK, thread = tid - block * BLOCK;
    const int rows = stack.shape[0], memory = rows / 2, slot = (state.newest.data[0] + 1) % memory;
    const int group = block / PARTS, part = block - group * PARTS, first = group * ROWS;
    const size_t size = (size_t)stack.shape[1] * stack.shape[2];
    const float* const step = stack.data + slot * size;
    const float* const difference = stack.data + (memory + slot) * size;
    const float* const gradient = stack.data + 2 * memory * size;
    double totals[ROWS][3] = {};
    for (size_t i = part * BLOCK + thread; i < size; i += PARTS * BLOCK) {
        float values[ROWS];
        #pragma unroll
        for (int r = 0; r < ROWS; ++r) values[r] = stack.data[min(first + r, rows - 1) * size + i];
        const double s = step[i], y = difference[i], g = gradient[i];
        #pragma unroll
        for (int r = 0; r < ROWS; ++r) {
            const double value = values[r];
            totals[r][0] += value * s;
            totals[r][1] += value * y;
            totals[r][2] += value * g;
        }
    }
    __shared__ double by_warp[BLOCK / 32][3 * ROWS];
    #pragma unroll
    for (int r = 0; r < ROWS; ++r)
        #pragma unroll
        for (int which = 0; which < 3; ++which) {
            double total = totals[r][which];
            for (int step = 16; step; step >>= 1) total += __shfl_xor_sync(~0u, total, step);
            if ((thread & 31) == 0) by_warp[thread >> 5][3 * r + which] = total;
        }
    __syncthreads();
    if (thread < 3 * ROWS && first + thread / 3 < rows) {
        double total = 0.0;
        for (int warp = 0; warp < BLOCK / 32; ++warp) total += by_warp[warp][thread];
        sums_out.data[part * 3 * rows + 3 * first + thread] = total;
    }
}

// The two-loop recursion on coefficients of the rows; if the trial was not accepted they stay what they are.
//
// Lane r of the first warp has coefficient r; sums over rows are sums over lanes.
void find_coefficients(
    int tid, State state, Array2<double> sums, double first_step, double pixels, int beginning,
    Array2<double> products_inout, Array1<double> coefficients_out) {
    if (state.accepted.data[0] != 1) return;
    const int thread = tid;
    __shared__ double g[32 * 32], fetched[TURNS][3 * 32], inverse[32];
    const int rows = products_inout.shape[0], memory = rows / 2, last = rows - 1;
    const int parts = sums.shape[0], lane = thread & 31;
    int newest = state.newest.data[0], pairs = state.pairs.data[0];
    const int slot = (newest + 1) % memory, turn = thread / 128, place = thread - turn * 128;
    if (place < 3 * rows) {
        double total = 0.0;
        #pragma unroll 8
        for (int part = turn; part < parts; part += TURNS) total += sums.data[part * 3 * rows + place];
        fetched[turn][place] = total;
    }
    for (int i = thread; i < rows * rows; i += 128 * TURNS) g[i / rows * 32 + i % rows] = products_inout.data[i];
    __syncthreads();
    if (thread >= 32) return;
    const bool mine = lane < rows;
    if (mine) {
        double by[3];
        for (int which = 0; which < 3; ++which) {
            by[which] = 0.0;
            for (int t = 0; t < TURNS; ++t) by[which] += fetched[t][3 * lane + which];
        }
        auto keep = [&](int row, double product) {
            g[lane * 32 + row] = g[row * 32 + lane] = product;
            products_inout.data[lane * rows + row] = products_inout.data[row * rows + lane] = product;
        };
        if (!beginning) {
            keep(slot, by[0]);
            keep(memory + slot, by[1]);
        }
        keep(last, by[2]);
    }
    __syncwarp();
    auto total = [&](double value) {
        for (int step = 16; step; step >>= 1) value += __shfl_xor_sync(~0u, value, step);
        return value;
    };
    if (!beginning) {
        const double sy = g[slot * 32 + memory + slot], ss = g[slot * 32 + slot];
        const double yy = g[(memory + slot) * 32 + memory + slot];
        if (sy > LEAST_CURVATURE * sqrt(ss * yy)) {
            newest = slot;
            pairs = min(pairs + 1, memory - 1);
        }
    }
    if (lane < memory) inverse[lane] = 1.0 / g[lane * 32 + memory + lane];
    __syncwarp();
    double c = lane == last ? -1.0 : 0.0, alpha = 0.0, slope = -g[last * 32 + last], step = 1.0;
    if (pairs > 0) {
        for (int k = 0; k < pairs; ++k) {
            const int p = (newest - k + memory) % memory;
            const double along = total(mine ? c * g[p * 32 + lane] : 0.0) * inverse[p];
            if (lane == p) alpha = along;
            if (lane == memory + p) c -= along;
        }
        c *= g[newest * 32 + memory + newest] / g[(memory + newest) * 32 + memory + newest];
        for (int k = 0; k < pairs; ++k) {
            const int p = (newest - pairs + 1 + k + memory) % memory;
            const double beta = total(mine ? c * g[(memory + p) * 32 + lane] : 0.0) * inverse[p];
            if (lane == p) c += alpha - beta;
        }
        slope = total(mine ? c * g[last * 32 + lane] : 0.0);
        if (slope >= 0.0) {  // no descent: begin anew
            c = lane == last ? -1.0 : 0.0;
            slope = -g[last * 32 + last];
            pairs = 0;
        }
    }
    if (pairs == 0) step = slope < 0.0 ? first_step / sqrt(-slope / pixels) : 0.0;
    if (mine) coefficients_out.data[lane] = c;
    if (lane == 0) {
        state.newest.data[0] = newest;
        state.pairs.data[0] = pairs;
        state.slope.data[0] = slope;
        state.step.data[0] = step;
        if (step == 0.0) state.go_on.data[0] = 0.0;
    }
}

// Σ coefficients[r] stack[r] in the units of x, 0 where the bounds stop it or hold the pixel.
void combine(
    int tid, Array3<float> stack, Array1<double> coefficients, Array2<float> x, Array2<float> root, float low,
    float high, Array2<float> direction_out) {
    const int block = tid / BLOCK, thread = tid - block * BLOCK;
    const size_t size = (size_t)stack.shape[1] * stack.shape[2];
    __shared__ float shares[COUNT];
    if (thread < COUNT) shares[thread] = (float)coefficients.data[thread];
    const size_t i = (size_t)block * BLOCK + thread;
    float values[COUNT], at = 0.f, unit = 1.f;
    if (i < size) {
        at = x.data[i];
        unit = root.data[i];
        #pragma unroll
        for (int r = 0; r < COUNT; ++r) values[r] = stack.data[r * size + i];
    }
    __syncthreads();
    if (i >= size) return;
    float total = 0.f;
    #pragma unroll
    for (int r = 0; r < COUNT; ++r) total += shares[r] != 0.f ? shares[r] * values[r] : 0.f;  // what is old may be NaN
    const float step = total / unit;
    const bool held = (at <= low || at >= high) && values[COUNT - 1] == 0.f;
    const bool stopped = (at <= low && step < 0.f) || (at >= high && step > 0.f);
    direction_out.data[i] = held || stopped ? 0.f : step;
}
