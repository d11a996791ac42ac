// The quantile of values on a GPU, by one block of BLOCK threads.
#pragma once
#include "lfgpu.h"

// Unsigned numbers in the order of the values, none of which is NaN.
inline unsigned key_of(float value) {
    const unsigned bits = (unsigned)__float_as_int(value);
    return bits >> 31 ? ~bits : bits | 0x80000000u;
}

// Eight bits at a time, the largest first, it is counted how many values have each of them; those of the quantile stay.
void find_quantile(
    int tid, Array1<float> values, Array1<float> among, Array1<double> least, double share,
    Array1<double> quantile_out) {
    __shared__ int counts[256];
    __shared__ int first, all;  // values below those that stay, and all of them
    __shared__ unsigned prefix, above;
    const int size = values.shape[0];
    auto counts_in = [&](int i) {
        return values.data[i] == values.data[i] && (!among.data || among.data[i] >= least.data[0]);
    };
    for (int shift = 24; shift >= 0; shift -= 8) {
        for (int k = tid; k < 256; k += BLOCK) counts[k] = 0;
        if (tid == 0 && shift == 24) {
            first = all = 0;
            prefix = 0u;
            above = ~0u;
        }
        __syncthreads();
        const unsigned kept = prefix;
        for (int i = tid; i < size; i += BLOCK) {
            const unsigned key = key_of(values.data[i]);
            const bool stays = shift == 24 || key >> (shift + 8) == kept >> (shift + 8);
            if (stays && counts_in(i)) atomicAdd(&counts[key >> shift & 255u], 1);
        }
        __syncthreads();
        if (tid == 0) {
            for (int k = 0; k < 256 && shift == 24; ++k) all += counts[k];
            const int place = (int)(share * (all - 1));
            int k = 0;
            while (k < 255 && first + counts[k] <= place) first += counts[k++];
            prefix |= (unsigned)k << shift;
        }
        __syncthreads();
    }
    // The next value is the same, if enough are left of it, else the least one above.
    const unsigned kept = prefix;
    unsigned next = ~0u;
    for (int i = tid; i < size; i += BLOCK) {
        const unsigned key = key_of(values.data[i]);
        if (key > kept && key < next && counts_in(i)) next = key;
    }
    atomicMin(&above, next);
    __syncthreads();
    if (tid > 0) return;
    auto value_of = [](unsigned key) { return (double)__uint_as_float(key >> 31 ? key & 0x7fffffffu : ~key); };
    const double place = share * (all - 1), low = value_of(kept);
    const bool repeats = (int)place + 1 < first + counts[kept & 255u] || above == ~0u;
    const double high = repeats ? low : value_of(above);
    quantile_out.data[0] = all > 0 ? (float)(low + (place - (int)place) * (high - low)) : NAN;
}
