"""Textures of generated scenes: coloured noise of many spectra, smooth, fine, streaked, or in two tones."""

import numpy as np

from lfgpu.contract import Float32Array

SIDE = 256
"""Pixels; textures repeat themselves."""

SMOOTH = 8
"""The first textures of a set have no fine detail: they make shadows and torn edges."""


def draw_textures(count: int, rng: np.random.Generator) -> Float32Array:
    """Draw `count` textures, float32 [count, SIDE, SIDE, 3], mostly in 0 to 1 with a mean near 0.5."""
    down, across = np.fft.fftfreq(SIDE)[:, None] * SIDE, np.fft.rfftfreq(SIDE)[None] * SIDE
    radius = np.maximum(np.hypot(down, across), 1.0)
    drawn = np.empty((count, SIDE, SIDE, 3), np.float32)
    for index in range(count):
        smooth = index < SMOOTH
        amplitude = radius ** -rng.uniform(1.3 if smooth else 0.2, 2.3 if smooth else 1.9)
        if smooth:
            amplitude = amplitude * (radius < rng.uniform(6, 40))
        elif rng.random() < 0.3:
            angle = rng.uniform(0, np.pi)
            along = (down * np.sin(angle) + across * np.cos(angle)) / radius
            amplitude = amplitude * np.exp(-rng.uniform(1, 8) * along**2)
        amplitude[0, 0] = 0
        spectrum = np.fft.rfft2(rng.standard_normal((3, SIDE, SIDE)))
        noise = np.fft.irfft2(spectrum * amplitude, s=(SIDE, SIDE))
        noise /= noise.std()
        grey = rng.random() ** 0.5
        noise = noise * (1 - grey) + 1.7 * grey * noise.mean(0)
        tone = 0.0 if smooth else rng.random()
        if 0 < tone < 0.2:  # two tones with sharp borders
            noise = 2 * np.tanh(3 * noise)
        elif 0.2 <= tone < 0.35:  # veins
            noise = 2.5 * np.abs(noise) - 2
        drawn[index] = np.clip(0.5 + 0.2 * noise, -0.2, 1.2).transpose(1, 2, 0)
    return drawn
