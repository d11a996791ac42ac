// The quantile of values on a GPU, by one block of BLOCK threads.
#pragma once
#include "lfgpu.h"

// Unsigned numbers in the order of the values, none of which is NaN.
inline unsigned key_of(float value) {
    const unsigned bits = (unsigned)__float_as_int(value);
    return bits >> 31 ? ~bits : bits | 0x80000000u;
}

constexpr int AT_ONCE = 8;  // values that a thread asks for before it waits for any

// Eight bits at a time, the largest first, it is counted how many values have each of them; those of the quantile stay.
void find_quantile(
    int tid, Array1<float> values, Array1<float> among, Array1<double> least, double share,
    Array1<double> quantile_out) {
    __shared__ int counts[256];
    __shared__ int first, equal;  // values below those that stay, and these
    __shared__ unsigned prefix, above;
    const int size = values.shape[0];
    const double limit = among.data ? least.data[0] : 0.;
    auto for_each = [&](auto work) {
        for (int start = tid; start < size; start += AT_ONCE * BLOCK) {
            float read[AT_ONCE], other[AT_ONCE];
            for (int j = 0; j < AT_ONCE; ++j) {
                const int i = start + j * BLOCK;
                read[j] = i < size ? values.data[i] : NAN;
                other[j] = i < size && among.data ? among.data[i] : 0.f;
            }
            for (int j = 0; j < AT_ONCE; ++j)
                if (read[j] == read[j] && (!among.data || other[j] >= limit)) work(key_of(read[j]));
        }
    };
    if (tid == 0) {
        first = equal = 0;
        prefix = 0u;
        above = ~0u;
    }
    double place = 0.;
    int all = 0;
    for (int shift = 24; shift >= 0; shift -= 8) {
        if (tid < 256) counts[tid] = 0;
        __syncthreads();
        const unsigned kept = prefix;
        const int below = first;
        for_each([&](unsigned key) {
            const bool stays = shift == 24 || key >> (shift + 8) == kept >> (shift + 8);
            if (stays) atomicAdd(&counts[key >> shift & 255u], 1);
        });
        __syncthreads();
        for (int reach = 1; reach < 256; reach *= 2) {  // sums of all counts up to each
            const int before = tid < 256 && tid >= reach ? counts[tid - reach] : 0;
            __syncthreads();
            if (tid < 256) counts[tid] += before;
            __syncthreads();
        }
        if (shift == 24) all = counts[255];
        place = share * (all - 1);
        const int from = tid > 0 && tid < 256 ? below + counts[tid - 1] : below;
        const int to = tid < 256 ? below + counts[tid] : from;
        if (from <= (int)place && (int)place < to) {
            first = from;
            equal = to - from;
            prefix = kept | (unsigned)tid << shift;
        }
        __syncthreads();
    }
    // The next value is the same, if enough are left of it, else the least one above.
    const unsigned kept = prefix;
    unsigned next = ~0u;
    for_each([&](unsigned key) {
        if (key > kept && key < next) next = key;
    });
    atomicMin(&above, next);
    __syncthreads();
    if (tid > 0) return;
    auto value_of = [](unsigned key) { return (double)__uint_as_float(key >> 31 ? key & 0x7fffffffu : ~key); };
    const double low = value_of(kept);
    const bool repeats = (int)place + 1 < first + equal || above == ~0u;
    const double high = repeats ? low : value_of(above);
    quantile_out.data[0] = all > 0 ? (float)(low + (place - (int)place) * (high - low)) : NAN;
}
