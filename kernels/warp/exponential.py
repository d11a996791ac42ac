"""exp on a CPU, as a line of native code that the compiler makes vectors of; it cannot do that with the library's."""

EXP = """
    // exp of what is at most 0, right to two units in the last place; below -87 as at -87: 1.6e-38.
    auto exp_of = [](float value) {
        const float inside = value > -87.f ? value : -87.f;
        const int doublings = (int)(inside * 1.44269504f - 0.5f);
        // ln 2 in two parts: a few bits, which make exact products, and the rest.
        const float rest = (inside - doublings * 0.693359375f) + doublings * 2.12194440e-4f;
        constexpr float factors[] = {1.f / 720, 1.f / 120, 1.f / 24, 1.f / 6, 1.f / 2, 1.f, 1.f};
        float sum = 1.f / 5040;
        for (int i = 0; i < 7; ++i) sum = sum * rest + factors[i];
        return sum * __builtin_bit_cast(float, (doublings + 127) << 23);
    };
"""
