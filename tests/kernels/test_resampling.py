"""Rectification's operation in the reference against the formula in a loop; and its check can fail."""

from __future__ import annotations

from dataclasses import replace

import checks
import numpy as np
import pytest
from resampling_cases import ResamplingCase, resampling_inputs
from resampling_checks import RESAMPLE
from single_faults import REFERENCE, Check, Fault, single_fault_tests
from ways_to_be_wrong import after, argument, option

CASE = ResamplingCase("any", dtype="float32")


def value_of(case: ResamplingCase) -> Check:
    return lambda kernels, rng: checks.check_value(kernels, "cpu", RESAMPLE, resampling_inputs(case, rng), 1e-5)


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


FAULTS = (
    Fault("places exchanged", "resample", argument(1, lambda p: p[..., [1, 0, 2]]), value_of(CASE)),
    Fault("half a pixel beside", "resample", argument(1, lambda p: p + np.array([0.5, 0.0, 0.0])), value_of(CASE)),
    Fault("falloff ignored", "resample", argument(1, lambda p: p * np.array([1.0, 1.0, 0.0])), value_of(CASE)),
    Fault("tones of another view", "resample", argument(2, lambda t: t[::-1]), value_of(CASE)),
    Fault("tones ignored", "resample", argument(2, lambda t: 0 * t + np.array([[1.0], [0.0], [0.0]])), value_of(CASE)),
    Fault("white of a byte", "resample", option("white", lambda _: 255.0), value_of(replace(CASE, tones=3.0, count=9))),
    Fault(
        "rounded down",
        "resample",
        after(lambda views: np.floor(views, out=views), "views_out"),
        value_of(replace(CASE, dtype="uint8")),
    ),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)
