// exp and log on a CPU, in a form that compilers make vectors of, which they cannot do with the library's.
#pragma once
#include "lfgpu.h"

// exp of what is at most 0, right to two units in the last place; below -87 as at -87: 1.6e-38.
inline float exp_of(float value) {
    const float inside = value > -87.f ? value : -87.f;
    const int doublings = (int)(inside * 1.44269504f - 0.5f);
    // ln 2 in two parts: a few bits, which make exact products, and the rest.
    const float rest = (inside - doublings * 0.693359375f) + doublings * 2.12194440e-4f;
    constexpr float factors[] = {1.f / 720, 1.f / 120, 1.f / 24, 1.f / 6, 1.f / 2, 1.f, 1.f};
    float sum = 1.f / 5040;
    for (int i = 0; i < 7; ++i) sum = sum * rest + factors[i];
    return sum * __builtin_bit_cast(float, (doublings + 127) << 23);
}

// log of what is above 0 and has all its digits, right to two units in the last place.
inline float log_of(float value) {
    const int bits = __builtin_bit_cast(int, value), doublings = (bits - 0x3f3504f3) >> 23;  // from the root of 1/2
    const float rest = __builtin_bit_cast(float, bits - (doublings << 23)) - 1.f;
    // The series of log(1 + rest), its last factors fitted.
    constexpr float factors[] = {-0.115146103f, 0.11676998f, -0.12420141f, 0.14249323f,
                                 -0.16668058f,  0.20000715f, -0.24999999f, 0.33333331f};
    float sum = 0.070376836f;
    for (int i = 0; i < 8; ++i) sum = sum * rest + factors[i];
    const float square = rest * rest;
    return doublings * 0.693359375f + (rest + (sum * rest * square - 0.5f * square - doublings * 2.12194440e-4f));
}
