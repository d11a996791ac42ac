"""Sweeps, occlusions and cost volumes in the reference against their definitions, with plain numbers."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import occlusion_checks
import pytest
import sweep_checks
import volume_checks
from checks import Operation, compute
from occlusion_checks import OCCLUSION_CASES, OcclusionCase, occlusion_inputs
from sweep_checks import SWEEP_CASES, SweepCase, sweep_inputs
from test_reference import REFERENCE, tent_of_any
from volume_checks import REDUCED_CASES, VOLUME_CASES, VolumeCase, volume_inputs

from lfgpu.contract import Disparities, half_window, sweep_shifts

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
        for column, row in itertools.product({math.floor(x), math.ceil(x)}, {math.floor(y), math.ceil(y)}):
            value += (1 - abs(x - column)) * (1 - abs(y - row)) * float(self.i.recorded[self.n, row, column, c])
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
    # 0.1 * 30 is not 3 in floating point.
    shifts = sweep_shifts(np.array([[1.0, -2.0], [0.5, 0.0]]), Disparities(-3.0, 0.1, 61))
    assert shifts.shape == (61, 2, 2)
    np.testing.assert_array_equal(shifts[::10, 0, 0], [3, 2, 1, 0, -1, -2, -3])
    np.testing.assert_array_equal(shifts[::5, 0, 1], np.arange(-6, 7))
    np.testing.assert_allclose(shifts[7, 1], [1.15, 0], rtol=0, atol=2.0**-17)


SMALL_OCCLUSIONS = [case for case in OCCLUSION_CASES if math.prod(case.size) <= 200]


def run(operation: Operation, inputs: SimpleNamespace) -> dict[str, np.ndarray]:
    return compute(REFERENCE, "cpu", operation, inputs)


def mean_of_what_lands(i: SimpleNamespace, n: int) -> tuple[np.ndarray, np.ndarray]:
    """View n and its coverage, pixel by pixel: the definition in `lfgpu/contract`, written out."""
    height, width = i.disparity.shape
    du, dv = i.offsets[n].astype(float)
    d, image = i.disparity.astype(float), i.image.astype(float)
    given = np.empty((height, width, height, width))
    for py, px in np.ndindex(height, width):
        to_x = [tent_of_any(qx - (px - d[py, px] * du), i.softness) for qx in range(width)]
        to_y = [tent_of_any(qy - (py - d[py, px] * dv), i.softness) for qy in range(height)]
        given[py, px] = np.outer(to_y, to_x)
    view, coverage = np.zeros(image.shape), given.sum((0, 1))
    for qy, qx in np.ndindex(height, width):
        reaching = [(py, px) for py, px in np.ndindex(height, width) if given[py, px, qy, qx] > 1e-20]
        if not reaching:
            continue
        front = max(d[p] for p in reaching)
        weights = [given[p][qy, qx] * math.exp(i.sharpness * (d[p] - front)) for p in reaching]
        view[qy, qx] = sum(w * image[p] for w, p in zip(weights, reaching, strict=True)) / sum(weights)
    return view, coverage


@pytest.mark.parametrize("case", SMALL_OCCLUSIONS, ids=str)
def test_splat_occluding_is_the_formula(case: OcclusionCase, rng: np.random.Generator) -> None:
    i = occlusion_inputs(case, rng)
    got = run(occlusion_checks.SPLAT, i)
    n = len(i.offsets) - 1
    view, coverage = mean_of_what_lands(i, n)
    np.testing.assert_allclose(got["views"][n], view, rtol=0, atol=1e-9)  # 1 - Λ near 0 has 1e-16 of rounding
    np.testing.assert_allclose(got["coverage"][n], coverage, rtol=0, atol=1e-12)


SMALL_VOLUMES = [case for case in VOLUME_CASES if math.prod(case.size) * case.count <= 1000]


def run_case(operation: Operation, case: VolumeCase, rng: np.random.Generator) -> tuple:
    inputs = volume_inputs(case, rng)
    return inputs, compute(REFERENCE, "cpu", operation, inputs)


@pytest.mark.parametrize("case", SMALL_VOLUMES, ids=str)
def test_average_is_that_of_each_pixel_with_its_neighbors(case: VolumeCase, rng: np.random.Generator) -> None:
    i, got = run_case(volume_checks.AVERAGE, case, rng)
    steps = [tuple(step) for step in half_window(case.window)]
    height, width = case.size
    for y, x in np.ndindex(height, width):
        weights, costs = [1.0], [i.volume[:, y, x].astype(np.float64)]
        for k, (dy, dx) in enumerate(steps):
            for qy, qx, wy, wx in ((y + dy, x + dx, y, x), (y - dy, x - dx, y - dy, x - dx)):
                if 0 <= qy < height and 0 <= qx < width:
                    weights.append(float(i.weights[k, wy, wx]))
                    costs.append(i.volume[:, qy, qx].astype(np.float64))
        want = sum(w * cost for w, cost in zip(weights, costs, strict=True)) / sum(weights)
        np.testing.assert_allclose(got["average"][:, y, x], want, rtol=1e-12)


def least_of_all_paths(i, steps: dict[str, float], pixels: list[tuple[int, int]]) -> np.ndarray:
    """The least cost of going through `pixels` for each disparity of the last one: all ways are tried."""
    count = len(i.volume)
    least = np.full(count, np.inf)
    for way in itertools.product(range(count), repeat=len(pixels)):
        cost = sum(float(i.volume[way[k], y, x]) for k, (y, x) in enumerate(pixels))
        for k in range(1, len(pixels)):
            difference = np.abs(i.image[pixels[k]].astype(np.float64) - i.image[pixels[k - 1]]).mean()
            likeness = math.exp(-difference / steps["contrast"])
            scale = float(i.penalty_scale[pixels[k]])
            one = scale * steps["small"] * max(likeness, 0.2)
            more = scale * max(steps["large"] * likeness, 1.2 * steps["small"])
            cost += (0.0, one, more)[min(2, abs(way[k] - way[k - 1]))]
        least[way[-1]] = min(least[way[-1]], cost)
    return least


@pytest.mark.parametrize("size", [(4, 5), (1, 4), (5, 1)])
@pytest.mark.parametrize("channels", [1, 3])
def test_semi_global_finds_the_best_of_all_paths(
    size: tuple[int, int], channels: int, rng: np.random.Generator
) -> None:
    case = VolumeCase("tiny", size=size, channels=channels, count=4, small=0.2, large=0.6, contrast=0.4)
    i, got = run_case(volume_checks.SEMI_GLOBAL, case, rng)
    height, width = size
    for y, x in ((0, 0), (height - 1, width - 1), (height // 2, width // 2), (height - 1, 0)):
        want = np.zeros(case.count)
        for dy, dx in itertools.product((-1, 0, 1), repeat=2):
            if (dy, dx) == (0, 0):
                continue
            pixels = [(y, x)]
            while 0 <= pixels[0][0] - dy < height and 0 <= pixels[0][1] - dx < width:
                pixels.insert(0, (pixels[0][0] - dy, pixels[0][1] - dx))
            want += least_of_all_paths(i, i.step_costs, pixels)
            if len(pixels) > 1:  # less what the best path to the pixel before costs
                want -= least_of_all_paths(i, i.step_costs, pixels[:-1]).min()
        np.testing.assert_allclose(got["sum"][:, y, x], want, rtol=1e-12)


@pytest.mark.parametrize("case", SMALL_VOLUMES, ids=str)
def test_lowest_is_the_minimum_of_the_parabola(case: VolumeCase, rng: np.random.Generator) -> None:
    i, got = run_case(volume_checks.LOWEST, case, rng)
    for name, volume in (("random", i.volume), ("alike", i.alike)):
        for y, x in np.ndindex(*case.size):
            costs = volume[:, y, x].astype(np.float64).tolist()
            k = min(max(costs.index(min(costs)), 1), case.count - 2)
            curve = np.polynomial.Polynomial(
                np.linalg.solve(np.vander([-1, 0, 1], increasing=True), costs[k - 1 : k + 2])
            )
            t = 0.0
            if curve.coef[2] > 0.5e-9:
                t = min(max(float(curve.deriv().roots()[0]), -1.0), 1.0)
            assert got[name][y, x] == pytest.approx(case.first + case.step * (k + t), abs=1e-9)


@pytest.mark.parametrize("case", [case for case in REDUCED_CASES if math.prod(case.size) <= 200], ids=str)
def test_reduced_volume_is_added_linear_between_the_middles_of_its_pixels(
    case: VolumeCase, rng: np.random.Generator
) -> None:
    i, got = run_case(volume_checks.ADD_REDUCED, case, rng)
    height, width = case.size
    middles = [4 * np.arange(side // 4) + 1.5 for side in case.size]
    for volume, before, reduced in zip(got["volume"], i.volume, i.reduced, strict=True):
        wide = np.array([np.interp(np.arange(width), middles[1], row) for row in i.shares.astype(np.float64) * reduced])
        whole = np.array([np.interp(np.arange(height), middles[0], column) for column in wide.T]).T
        np.testing.assert_allclose(volume, before + i.weight * whole, rtol=0, atol=1e-12 * np.abs(i.volume).max())


@pytest.mark.parametrize("case", SMALL_VOLUMES, ids=str)
def test_edges_count_less_the_larger_the_steps_near_them(case: VolumeCase, rng: np.random.Generator) -> None:
    i, got = run_case(volume_checks.EDGES, case, rng)
    height, width = case.size
    image = i.image.astype(np.float64)
    for y, x in np.ndindex(height, width):
        for name, reach in (("beside", 1), ("around", 3)):
            near = image[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
            largest = max(float(np.abs(np.diff(near, axis=a)).mean(2).max(initial=0.0)) for a in (0, 1))
            assert got[name][y, x] == pytest.approx(1 / (1 + (largest / i.edge_contrast) ** 2), rel=1e-12)
