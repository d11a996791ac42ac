"""Alignment, nearest surfaces and ratios in the reference backend against the formulas of the contract as loops."""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from types import SimpleNamespace

import alignment_checks
import numpy as np
import pytest
from alignment_cases import ALIGNMENT_CASES, RATIO_CASES, AlignmentCase, RatioCase, alignment_inputs, ratio_inputs
from checks import Operation, compute
from test_reference import REFERENCE

from lfgpu.types import half_window

SMALL = [case for case in ALIGNMENT_CASES if math.prod(case.size) <= 200]


def run(operation: Operation, inputs: SimpleNamespace) -> dict[str, np.ndarray]:
    return compute(REFERENCE, "cpu", operation, inputs)


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_nearest_surface_is_what_comparing_every_two_pixels_says(case: AlignmentCase, rng: np.random.Generator) -> None:
    i = alignment_inputs(case, rng)
    height, width = case.size
    d = i.disparity.astype(float).ravel()
    rows, columns = (place.ravel() for place in np.mgrid[:height, :width])
    got = run(alignment_checks.NEAREST, i)["nearest"]
    for view, (du, dv) in zip(got, i.offsets.astype(float), strict=True):
        x, y = np.floor(columns - d * du + 0.5), np.floor(rows - d * dv + 0.5)
        # [q, p]: how far p lands from q
        distance = np.maximum(np.abs(x - columns[:, None]), np.abs(y - rows[:, None]))
        within = (np.where(distance <= i.reach + more, d, -1e6).max(1) for more in (0, 1))
        near, farther = (found.reshape(height, width) for found in within)
        np.testing.assert_array_equal(view, np.where(near > -1e6, near, farther))


def aligned(i: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """Curvature and slope pixel by pixel: the definition in `lfgpu/types.py`, written out."""
    (height, width), w = i.disparity.shape, i.gradient_weight
    others = [n for n, offset in enumerate(i.offsets.astype(float)) if math.hypot(*offset) > 1e-3]
    views = {n: i.scale * i.recorded[n].astype(float) for n in others} | {-1: i.image.astype(float)}

    def color(n: int, y: int, x: int) -> np.ndarray:
        return views[n][min(max(y, 0), height - 1), min(max(x, 0), width - 1)]

    @cache
    def feature(n: int, y: int, x: int) -> np.ndarray:
        across = (color(n, y, x + 1) - color(n, y, x - 1)) / 2
        down = (color(n, y + 1, x) - color(n, y - 1, x)) / 2
        return np.concatenate([color(n, y, x), w * across, w * down])

    @cache
    def change(n: int, y: int, x: int) -> np.ndarray:
        du, dv = i.offsets[n].astype(float)
        across = (feature(n, y, x + 1) - feature(n, y, x - 1)) / 2
        down = (feature(n, y + 1, x) - feature(n, y - 1, x)) / 2
        return -(du * across + dv * down)

    def weight(residual: np.ndarray) -> float:
        return float(1 / (1 + (residual**2).mean() / i.robust**2) ** 2)

    curvature, slope = np.zeros((height, width)), np.zeros((height, width))
    for py, px in np.ndindex(height, width):
        d, seen = float(i.disparity[py, px]), []
        for n in others:
            x, y = px - d * float(i.offsets[n, 0]), py - d * float(i.offsets[n, 1])
            if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
                continue
            pixel = n, math.floor(y + 0.5), math.floor(x + 0.5)
            if (i.valid is not None and i.valid[pixel] == 0) or d < float(i.nearest[pixel]) - i.tolerance:
                continue
            left, top = math.floor(x), math.floor(y)
            f, g = np.zeros(0), np.zeros(0)
            for ty, tx in product((top, top + 1), (left, left + 1)):
                share = (1 - abs(x - tx)) * (1 - abs(y - ty))
                f = share * feature(n, ty, tx) + (f if f.size else 0)
                g = share * change(n, ty, tx) + (g if g.size else 0)
            seen.append((f, g))
        own = feature(-1, py, px)
        shares = [weight(f - own) for f, _ in seen]
        mean = (own + sum(k * f for k, (f, _) in zip(shares, seen, strict=True))) / (1 + sum(shares))
        for f, g in seen:
            curvature[py, px] += weight(f - mean) * (g**2).mean() / len(others)
            slope[py, px] -= weight(f - mean) * (g * (f - mean)).mean() / len(others)
    return curvature, slope


@pytest.mark.parametrize("case", SMALL, ids=str)
def test_alignment_is_the_formula(case: AlignmentCase, rng: np.random.Generator) -> None:
    i = alignment_inputs(case, rng)
    got = run(alignment_checks.ALIGNMENT, i)
    for name, want in zip(("curvature", "slope"), aligned(i), strict=True):
        np.testing.assert_allclose(got[name], want, rtol=0, atol=1e-12 * max(1.0, float(np.abs(want).max())))


def test_alignment_of_the_cases_has_views_that_count_and_views_that_do_not(rng: np.random.Generator) -> None:
    """Of the first case, so that others that are made like it say something."""
    i = alignment_inputs(ALIGNMENT_CASES[0], rng)
    got = run(alignment_checks.ALIGNMENT, i)["curvature"]
    every = SimpleNamespace(**{**vars(i), "nearest": np.full_like(i.nearest, -1e6)})
    assert (got > 0).mean() > 0.9
    assert (run(alignment_checks.ALIGNMENT, every)["curvature"] != got).mean() > 0.5


@pytest.mark.parametrize("case", [case for case in RATIO_CASES if math.prod(case.size) <= 400], ids=str)
def test_nlm_ratio_is_the_formula(case: RatioCase, rng: np.random.Generator) -> None:
    i = ratio_inputs(case, rng)
    (height, width), guide = case.size, i.guide.astype(float)
    steps = [(k, dy, dx) for k, (dy, dx) in enumerate(half_window(case.window))]
    want = np.empty(case.size)
    for y, x in np.ndindex(height, width):
        above, below = float(i.values[y, x]), float(i.denominator[y, x]) + case.least
        for (k, dy, dx), sign in product(steps, (1, -1)):
            q = y + sign * dy, x + sign * dx
            if 0 <= q[0] < height and 0 <= q[1] < width:
                w = float(i.weights[k][(y, x) if sign > 0 else q])
                v = w / (1 + (guide[q] - guide[y, x]) ** 2 / case.support**2)
                above += v * float(i.values[q])
                below += v * (float(i.denominator[q]) + case.least)
        want[y, x] = above / below
    np.testing.assert_allclose(run(alignment_checks.RATIO, i)["ratio"], want, rtol=0, atol=1e-12 * np.abs(want).max())
