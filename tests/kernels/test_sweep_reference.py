"""The plane sweep of the reference backend against its definition, pixel by pixel with plain numbers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import sweep_checks
from checks import compute
from sweep_cases import SWEEP_CASES, SweepCase, sweep_inputs
from test_reference import REFERENCE

from lfgpu.contract import Disparities, sweep_shifts

SMALL = [case for case in SWEEP_CASES if math.prod(case.size) <= 200]
PIXELS = 4  # of each case are computed


class Written:
    """The definition in `lfgpu/contract`, written out for one view at one disparity."""

    def __init__(self, i: SimpleNamespace, label: int, n: int) -> None:
        self.i, self.n = i, n
        self.height, self.width = i.image.shape[:2]
        disparity = i.options["first"] + label * i.options["step"]
        # On a grid of 2^-16 pixels, so that what lies just inside the frame is not a matter of rounding.
        self.shift = [round(-disparity * float(o) * 65536) / 65536 for o in i.offsets[n]]
        self.limit = disparity + i.options["tolerance"]

    def recorded(self, x: float, y: float, c: int) -> float:
        """Bilinear; what is outside of the frame is its border."""
        x, y = min(max(x, 0.0), self.width - 1.0), min(max(y, 0.0), self.height - 1.0)
        value = 0.0
        for column in range(self.width):
            for row in range(self.height):
                weight = max(0.0, 1 - abs(x - column)) * max(0.0, 1 - abs(y - row))
                if weight > 0:
                    value += weight * float(self.i.recorded[self.n, row, column, c])
        return float(self.i.options["scale"] * value)

    def difference(self, x: int, y: int, c: int) -> float:
        x, y = min(max(x, 0), self.width - 1), min(max(y, 0), self.height - 1)
        return self.recorded(x + self.shift[0], y + self.shift[1], c) - float(self.i.image[y, x, c])

    def cost(self, x: int, y: int, weight: float, truncation: float) -> float:
        channels = range(self.i.image.shape[2])
        color = sum(abs(self.difference(x, y, c)) for c in channels) / len(channels)
        slopes = [
            abs(self.difference(x + dx, y + dy, c) - self.difference(x - dx, y - dy, c)) / 2
            for c in channels
            for dx, dy in ((1, 0), (0, 1))
        ]
        gradient = min(sum(slopes) / len(slopes), self.i.options["gradient_truncation"])
        return float((sweep_checks.rooted(min(color, truncation), self.i) + weight * gradient) / (1 + weight))

    def takes_part(self, x: int, y: int) -> bool:
        place = x + self.shift[0], y + self.shift[1]
        if math.hypot(*self.i.offsets[self.n]) <= 1e-3:
            return False
        if not (0 <= place[0] <= self.width - 1 and 0 <= place[1] <= self.height - 1):
            return False
        return self.i.valid is None or self.i.valid[(self.n, *self.nearest(x, y))] != 0

    def nearest(self, x: int, y: int) -> tuple[int, int]:
        return math.floor(y + self.shift[1] + 0.5), math.floor(x + self.shift[0] + 0.5)

    def sees(self, x: int, y: int) -> bool:
        return self.takes_part(x, y) and bool(self.i.nearest[(self.n, *self.nearest(x, y))] <= self.limit)


def mean(costs: list[float]) -> float:
    return sum(costs) / len(costs)


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_sweep_is_the_definition(case: SweepCase, rng: np.random.Generator) -> None:
    i = sweep_inputs(case, rng)
    got = compute(REFERENCE, "cpu", sweep_checks.SWEEP, i)
    as_planned = i.options["gradient_weight"], i.options["truncation"]
    for _ in range(PIXELS):
        label, y, x = (int(rng.integers(side)) for side in got["seen"].shape)
        views = [Written(i, label, n) for n in range(len(i.offsets))]
        costs = {n: view.cost(x, y, *as_planned) for n, view in enumerate(views) if view.takes_part(x, y)}
        lowest = sweep_checks.most(i, "view_sets")
        for m, members in enumerate(i.view_sets):
            inside = [cost for n, cost in costs.items() if members[n]]
            if inside:
                lowest = min(lowest, mean(inside) * (1 + case.preference) + 1e-4 if m else mean(inside))
        assert got["view_sets"][label, y, x] == pytest.approx(lowest, abs=1e-12)
        for name, counted in (("seen", as_planned), ("intensities", (0.0, sweep_checks.INTENSITY_TRUNCATION))):
            seeing = [view.cost(x, y, *counted) for view in views if view.sees(x, y)]
            want = mean(seeing) if len(seeing) >= case.least else sweep_checks.most(i, name)
            assert got[name][label, y, x] == pytest.approx(want, abs=1e-12)


def test_cases_reach_what_they_should(rng: np.random.Generator) -> None:
    """Costs lie on both sides of what truncates them, other view_sets than the first win, and some see too little."""
    i = sweep_inputs(SweepCase("any", size=(23, 21), masked=True), rng)
    got = compute(REFERENCE, "cpu", sweep_checks.SWEEP, i)
    alone = compute(REFERENCE, "cpu", sweep_checks.SWEEP, sweep_checks.changed(i, view_sets=i.view_sets[:1]))
    assert 0.1 < (got["view_sets"] < alone["view_sets"]).mean() < 0.99
    assert 0.001 < (got["seen"] == sweep_checks.most(i, "seen")).mean() < 0.9
    limits = i.options["truncation"], i.options["gradient_truncation"]
    for truncation, name in zip(limits, ("truncation", "gradient_truncation"), strict=True):
        more = sweep_checks.changed(i, options={**i.options, name: 1.5 * truncation})
        differs = compute(REFERENCE, "cpu", sweep_checks.SWEEP, more)["view_sets"] != got["view_sets"]
        assert 0.1 < differs.mean() <= 1


def test_shifts_that_should_be_whole_are() -> None:
    """0.1 * 30 is not 3 in floating point."""
    shifts = sweep_shifts(np.array([[1.0, -2.0], [0.5, 0.0]]), Disparities(-3.0, 0.1, 61))
    assert shifts.shape == (61, 2, 2)
    np.testing.assert_array_equal(shifts[::10, 0, 0], [3, 2, 1, 0, -1, -2, -3])
    np.testing.assert_array_equal(shifts[::5, 0, 1], np.arange(-6, 7))
    np.testing.assert_allclose(shifts[7, 1], [1.15, 0], rtol=0, atol=2.0**-17)
