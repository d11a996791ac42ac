"""Rectification's operation in the reference against the formula in a loop."""

from dataclasses import replace

import checks
import numpy as np
import pytest
from resampling_cases import ResamplingCase, resampling_inputs
from resampling_checks import RESAMPLE

from lfgpu._backends import load

REFERENCE = load("reference")
CASE = ResamplingCase("any", dtype="float32")


def keys(distance: float) -> float:
    """The kernel of Keys, a = -1/2, as its paper has it."""
    s = abs(distance)
    if s < 1:
        return 1.5 * s**3 - 2.5 * s**2 + 1
    return -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2 if s < 2 else 0.0


def test_resample_is_the_formula(rng: np.random.Generator) -> None:
    case = replace(CASE, size=(6, 5), out_size=(4, 7), count=2)
    i = resampling_inputs(case, rng)
    got = checks.compute(REFERENCE, "cpu", RESAMPLE, i)["views"]
    height, width = case.size
    for n, y, x, c in np.ndindex(got.shape):
        px, py, q = map(float, i.places[n, y, x])
        if not (-0.5 <= px <= width - 0.5 and -0.5 <= py <= height - 0.5):
            assert got[n, y, x, c] == 0
            continue
        px, py = min(max(px, 0), width - 1), min(max(py, 0), height - 1)
        total = 0.0
        for row in range(int(py) - 1, int(py) + 3):
            for column in range(int(px) - 1, int(px) + 3):
                pixel = i.pictures[n, min(max(row, 0), height - 1), min(max(column, 0), width - 1), c]
                total += keys(row - py) * keys(column - px) * float(pixel)
        gain, offset, falloff = map(float, i.tones[n, :, c])
        want = min(max((total - offset) / max(gain + falloff * q, 0.05), 0), i.white)
        assert got[n, y, x, c] == pytest.approx(want, abs=1e-9)


def test_whole_pixels_stay_as_they_are(rng: np.random.Generator) -> None:
    i = resampling_inputs(ResamplingCase("own", reach=0.0, tones=0.0), rng)
    got = checks.compute(REFERENCE, "cpu", RESAMPLE, i)["views"]
    there = np.isfinite(i.places[..., 0])
    np.testing.assert_allclose(got[there], i.pictures[there], rtol=0, atol=1e-9)
