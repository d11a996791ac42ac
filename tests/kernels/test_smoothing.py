"""Smoothing and reducing in the reference against the formulas in loops."""

import math

import numpy as np
import pytest
import smoothing_checks
from checks import compute
from smoothing_cases import REDUCTION_CASES, SMOOTHING_CASES, SmoothingCase, smoothing_inputs
from test_reference import REFERENCE

SMALL = [case for case in SMOOTHING_CASES if math.prod(case.size) <= 200]
REDUCED = [case for case in REDUCTION_CASES if math.prod(case.size) <= 500]


def whole(intensity: float) -> int:
    """As uint16 holds it."""
    return math.floor(65535 * min(max(intensity, 0.0), 1.0) + 0.5)


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_smoothing_is_the_formula(case: SmoothingCase, rng: np.random.Generator) -> None:
    i = smoothing_inputs(case, rng)
    got = compute(REFERENCE, "cpu", smoothing_checks.SMOOTH, i)["views"]
    height, width = case.size
    n = case.count - 1
    view = i.scale * i.views[n].astype(np.float64)

    def known(y: int, x: int) -> bool:
        return i.valid is None or bool(i.valid[n, y, x] != 0)

    def guide(y: int, x: int) -> np.ndarray:
        around = [
            (min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)
        ]
        return np.mean([view[q] for q in around if known(*q)], axis=0)

    guides = {place: guide(*place) for place in np.ndindex(height, width) if known(*place)}
    for y, x in np.ndindex(height, width):
        total, weights = np.zeros(case.channels), 0.0
        for q in guides:
            dy, dx = q[0] - y, q[1] - x
            if max(abs(dy), abs(dx)) > 3:
                continue
            unlike = float(((guides[q] - guides[y, x]) ** 2).mean()) / i.deviation**2 if known(y, x) else 0.0
            weight = math.exp(-(dy * dy + dx * dx) / 8) / (1 + unlike) ** 2
            total += weight * view[q]
            weights += weight
        want = [65535 * min(max(mean, 0.0), 1.0) for mean in total / (weights or 1)]
        np.testing.assert_allclose(got[n, y, x], want, rtol=0, atol=0.5 + 1e-6)
        np.testing.assert_array_equal(got[n, y, x], np.rint(got[n, y, x]))


@pytest.mark.parametrize("case", REDUCED, ids=str)
def test_reducing_is_the_formula(case: SmoothingCase, rng: np.random.Generator) -> None:
    i = smoothing_inputs(case, rng)
    got = compute(REFERENCE, "cpu", smoothing_checks.REDUCE, i)
    for n, y, x in np.ndindex(case.count, case.size[0] // 4, case.size[1] // 4):
        block = n, slice(4 * y, 4 * y + 4), slice(4 * x, 4 * x + 4)
        for c in range(case.channels):
            values = [
                float(i.views[(n, row, column, c)])
                for row in range(4 * y, 4 * y + 4)
                for column in range(4 * x, 4 * x + 4)
                if i.by_block is None or i.by_block[n, row, column] != 0
            ]
            want = 65535 * min(max(i.scale * math.fsum(values) / max(len(values), 1), 0.0), 1.0)
            assert got["views"][n, y, x, c] == pytest.approx(want, abs=0.5 + 1e-6)
        if i.by_block is not None:
            assert got["valid"][n, y, x] == all(i.by_block[block].ravel())


def test_masks_of_blocks_leave_something_to_decide(rng: np.random.Generator) -> None:
    """All valid, none and some: of each there are blocks, so that none of them is taken for another."""
    (case,) = (case for case in REDUCTION_CASES if case.name == "work for several threads")
    blocks = smoothing_inputs(case, rng).by_block[:, :60, :36].reshape(case.count, 15, 4, 9, 4) != 0
    every, some = blocks.all((2, 4)), blocks.any((2, 4))
    assert min(every.mean(), (some & ~every).mean(), (~some).mean()) > 0.05
