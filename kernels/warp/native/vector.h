// What a solver does with fields. On a CPU one thread goes through all numbers, and vector units have many at a time.
#pragma once
#include "lfgpu.h"

// The inner product: eight sums side by side, which a CPU adds to at once, in an order that is always the same.
inline double dot_of(const float* __restrict__ a, const float* __restrict__ b, size_t size) {
    double totals[8] = {};
    size_t i = 0;
    for (; i + 8 <= size; i += 8)
        for (int j = 0; j < 8; ++j) totals[j] += (double)a[i + j] * (double)b[i + j];
    for (; i < size; ++i) totals[0] += (double)a[i] * (double)b[i];
    double sum = 0.0;
    for (int j = 0; j < 8; ++j) sum += totals[j];
    return sum;
}

void dot(Array1<float> x, Array1<float> y, Array1<double> product_out) {
    product_out.data[0] = dot_of(x.data, y.data, x.shape[0]);
}

// Write EACH, which is made of numbers a and b and of fields xs[i], ys[i] and zs[i], to the `many` places of a thread.
void for_each(
    int tid, Number a, Number b, int many, Array1<float> x, Array1<float> y, Array1<float> z,
    Array1<float> result_out) {
    #pragma clang fp contract(off)
    const size_t first = (size_t)tid * many, last = first + many;
    const float* const xs = x.data;
    const float* const ys = y.data;
    const float* const zs = z.data;
    #pragma clang loop vectorize(assume_safety)
    for (size_t i = first; i < last; ++i) result_out.data[i] = EACH;
}

// Inner products of the rows of the stack of L-BFGS from `first` to before `last` with the new step, the new difference
// and the projected gradient.
void find_products(State state, Array3<float> stack, int first, int last, Array2<double> sums_out) {
    if (state.accepted.data[0] != 1) return;
    const int memory = stack.shape[0] / 2, slot = (state.newest.data[0] + 1) % memory;
    const size_t size = (size_t)stack.shape[1] * stack.shape[2];
    for (int r = first; r < last; ++r) {
        const float* const a = stack.data + r * size;
        sums_out.data[3 * r] = dot_of(a, stack.data + slot * size, size);
        sums_out.data[3 * r + 1] = dot_of(a, stack.data + (memory + slot) * size, size);
        sums_out.data[3 * r + 2] = dot_of(a, stack.data + 2 * memory * size, size);
    }
}

// A step of conjugate gradients, once pᵀ q is known.
void conjugate_step(
    Array1<double> pq, Array1<float> q, Array1<float> preconditioner, Array1<double> go_on, Array1<double> rz,
    Array1<float> p, Array1<float> x, Array1<float> r) {
    const size_t size = x.shape[0];
    const float alpha = pq.data[0] != 0.0 && go_on.data[0] > 0.0 ? (float)(rz.data[0] / pq.data[0]) : 0.f;
    const float* __restrict__ const a = p.data;
    const float* __restrict__ const b = q.data;
    const float* __restrict__ const m = preconditioner.data;
    float* __restrict__ const to = x.data;
    float* __restrict__ const left = r.data;
    double totals[8] = {};
    auto move = [&](size_t i, int j) {
        to[i] += alpha * a[i];
        left[i] -= alpha * b[i];
        totals[j] += (double)left[i] * (double)(m[i] * left[i]);
    };
    size_t i = 0;
    for (; i + 8 <= size; i += 8)
        for (int j = 0; j < 8; ++j) move(i + j, j);
    for (; i < size; ++i) move(i, 0);
    double next = 0.0;
    for (int j = 0; j < 8; ++j) next += totals[j];
    const float beta = rz.data[0] != 0.0 ? (float)(next / rz.data[0]) : 0.f;
    float* __restrict__ const along = p.data;
    for (size_t i = 0; i < size; ++i) along[i] = m[i] * left[i] + beta * along[i];
    rz.data[0] = next;
}
