"""Cost volumes in the reference backend against independent truths: pixel by pixel, and path by path."""

import itertools
import math

import numpy as np
import pytest
import volume_checks
from checks import Operation, compute
from test_reference import REFERENCE
from volume_cases import REDUCED_CASES, VOLUME_CASES, VolumeCase, volume_inputs

from lfgpu.contract import half_window

SMALL = [case for case in VOLUME_CASES if math.prod(case.size) * case.count <= 1000]


def run(operation: Operation, case: VolumeCase, rng: np.random.Generator) -> tuple:
    inputs = volume_inputs(case, rng)
    return inputs, compute(REFERENCE, "cpu", operation, inputs)


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_average_is_that_of_each_pixel_with_its_neighbors(case: VolumeCase, rng: np.random.Generator) -> None:
    i, got = run(volume_checks.AVERAGE, case, rng)
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
    i, got = run(volume_checks.SEMI_GLOBAL, case, rng)
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


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_lowest_is_the_minimum_of_the_parabola(case: VolumeCase, rng: np.random.Generator) -> None:
    i, got = run(volume_checks.LOWEST, case, rng)
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
    i, got = run(volume_checks.ADD_REDUCED, case, rng)
    height, width = case.size
    middles = [4 * np.arange(side // 4) + 1.5 for side in case.size]
    for volume, before, reduced in zip(got["volume"], i.volume, i.reduced, strict=True):
        wide = np.array([np.interp(np.arange(width), middles[1], row) for row in i.shares.astype(np.float64) * reduced])
        whole = np.array([np.interp(np.arange(height), middles[0], column) for column in wide.T]).T
        np.testing.assert_allclose(volume, before + i.weight * whole, rtol=0, atol=1e-12 * np.abs(i.volume).max())


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_edges_count_less_the_larger_the_steps_near_them(case: VolumeCase, rng: np.random.Generator) -> None:
    i, got = run(volume_checks.EDGES, case, rng)
    height, width = case.size
    image = i.image.astype(np.float64)
    for y, x in np.ndindex(height, width):
        for name, reach in (("beside", 1), ("around", 3)):
            near = [(v, u) for v, u in np.ndindex(height, width) if max(abs(v - y), abs(u - x)) <= reach]
            pairs = [(p, q) for p, q in itertools.combinations(near, 2) if abs(p[0] - q[0]) + abs(p[1] - q[1]) == 1]
            largest = max((np.abs(image[p] - image[q]).mean() for p, q in pairs), default=0.0)
            assert got[name][y, x] == pytest.approx(1 / (1 + (largest / i.edge_contrast) ** 2), rel=1e-12)
