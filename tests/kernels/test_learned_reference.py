"""The learned aggregation's operations in the reference backend against independent truths, number by number."""

import math

import learned_checks
import numpy as np
import pytest
from checks import compute
from learned_cases import (
    CONVOLUTION_CASES,
    PEAK_CASES,
    SECTOR_CASES,
    ConvolutionCase,
    PeakCase,
    SectorCase,
    convolution_inputs,
    peak_inputs,
    sector_inputs,
)
from test_reference import REFERENCE

from lfgpu.contract import sectors_of

SMALL_SECTORS = [case for case in SECTOR_CASES if math.prod(case.size) * len(case.offsets) <= 1500]
SMALL_LAYERS = [case for case in CONVOLUTION_CASES if math.prod(case.size) <= 240 and case.stored == "float32"]


def cost_at(i, n: int, y: int, x: int, d: float) -> list[float] | None:
    """The differences of a view from a pixel at a disparity, by channel; None where it takes no part."""
    height, width, channels = i.image.shape
    tx, ty = x - d * float(i.offsets[n, 0]), y - d * float(i.offsets[n, 1])
    if not (0 <= tx <= width - 1 and 0 <= ty <= height - 1):
        return None
    if i.valid is not None and not i.valid[n, math.floor(ty + 0.5), math.floor(tx + 0.5)]:
        return None
    differences = []
    for c in range(channels):
        value = 0.0
        for row in range(height):
            for column in range(width):
                share = max(0.0, 1 - abs(row - ty)) * max(0.0, 1 - abs(column - tx))
                if share:
                    value += share * i.scale * float(i.recorded[n, row, column, c])
        differences.append(i.factor * (value - float(i.image[y, x, c])))
    return differences


@pytest.mark.parametrize("case", SMALL_SECTORS, ids=str)
def test_costs_are_those_of_each_sector(case: SectorCase, rng: np.random.Generator) -> None:
    i = sector_inputs(case, rng)
    got = compute(REFERENCE, "cpu", learned_checks.SECTOR_COSTS, i)["costs"]
    for _ in range(12):
        label = int(rng.integers(len(got)))
        y, x = (int(rng.integers(2 * side)) for side in i.folded)
        row, column = min(y, case.size[0] - 1), min(x, case.size[1] - 1)
        d = float(i.first[row, column]) + (case.label + label) * case.step
        single, common = [math.nan] * 8, [math.nan] * 8
        for sector in range(8):
            found = []
            for n, (du, dv) in enumerate(i.offsets):
                angle = math.degrees(math.atan2(dv, du))
                if math.hypot(du, dv) > 1e-3 and abs((angle - 45 * sector + 180) % 360 - 180) < 22.5:
                    found.append(cost_at(i, n, row, column, d))
            there = np.array([values for values in found if values is not None])
            if len(there):
                single[sector], common[sector] = np.abs(there).mean(), np.abs(there.mean(0)).mean()
        want = np.log(1 + np.array([single, common]) / 0.02) / 4
        for some in want:
            some[np.isnan(some)] = np.nanmean(some) if np.isfinite(some).any() else 1.0
        folded = got[label, y // 2, x // 2].reshape(16, 2, 2)
        np.testing.assert_allclose(folded[:, y % 2, x % 2], want.ravel(), atol=1e-9)


def test_sectors_begin_at_the_right_and_turn_downwards() -> None:
    offsets = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (0, 0), (5, 2), (5, -2.1), (1, 3)]
    assert sectors_of(np.array(offsets)).tolist() == [0, 1, 2, 3, 4, 5, 6, 7, -1, 0, 7, 2]


@pytest.mark.parametrize("case", SMALL_LAYERS, ids=str)
def test_convolution_is_that_of_each_voxel(case: ConvolutionCase, rng: np.random.Generator) -> None:
    i = convolution_inputs(case, rng)
    got = compute(REFERENCE, "cpu", learned_checks.CONVOLUTION, i)["result"]
    np.testing.assert_array_equal(got[: case.at], i.before[: case.at])
    got = got[case.at :]
    for _ in range(12):
        place = [int(rng.integers(length)) for length in got.shape[:3]]
        want = i.bias.astype(np.float64).copy()
        for tap in np.ndindex(case.window):
            shifts = (k - size // 2 for k, size in zip(tap, case.window, strict=True))
            there = [p * stride + k for p, stride, k in zip(place, case.strides, shifts, strict=True)]
            if all(0 <= t < length for t, length in zip(there, case.size, strict=True)):
                want += i.volume[tuple(there)].astype(np.float64) @ i.weights[tap].astype(np.float64)
        if case.added is not None:
            want += i.added[tuple(p // by for p, by in zip(place, case.added, strict=True))]
        np.testing.assert_allclose(got[tuple(place)], np.maximum(want, 0) if case.rectified else want, atol=1e-9)


@pytest.mark.parametrize("case", PEAK_CASES, ids=str)
def test_peak_is_that_of_each_pixel(case: PeakCase, rng: np.random.Generator) -> None:
    i = peak_inputs(case, rng)
    got = compute(REFERENCE, "cpu", learned_checks.PEAK, i)
    for _ in range(20):
        y, x = (int(rng.integers(side)) for side in case.size)
        row = [float(logit) for logit in i.logits[:, y // 2, x // 2, 2 * (y % 2) + x % 2]]
        best = row.index(max(row))
        near = [(math.exp(row[k] - row[best]), k) for k in range(best - 2, best + 3) if 0 <= k < len(row)]
        total = sum(share for share, _ in near)
        mean = sum(share * k for share, k in near) / total
        variance = sum(share * (k - mean) ** 2 for share, k in near) / total
        assert got["disparity"][y, x] == pytest.approx(float(i.first[y, x]) + i.step * mean)
        assert got["probability"][y, x] == pytest.approx(total / sum(math.exp(v - row[best]) for v in row))
        assert got["deviation"][y, x] == pytest.approx(i.step * math.sqrt(variance), abs=1e-9)


def test_references_become_about_as_bright() -> None:
    for mean, want in ((0.32, 1.0), (0.0, 4.0), (1.0, 0.5), (0.12, 2.0)):
        factor = np.zeros(1)
        REFERENCE.brightness(np.full((3, 4, 3), mean), factor_out=factor)
        assert factor[0] == pytest.approx(want)


def test_squares_of_pixels_become_channels() -> None:
    image = np.arange(18.0).reshape(2, 3, 3)
    out = np.full((1, 1, 2, 16), np.nan)
    REFERENCE.fold(image, np.array([2.0]), folded_out=out)
    want = [0, 6, 18, 24, 2, 8, 20, 26, 4, 10, 22, 28, 0, 0, 0, 0]
    assert out[0, 0, 0].tolist() == want
    assert out[0, 0, 1, :4].tolist() == [12, 12, 30, 30]
    REFERENCE.fold(image[..., :1], np.array([1.0]), folded_out=out)
    assert out[0, 0, 0].tolist() == 3 * [0, 3, 9, 12] + [0, 0, 0, 0]
