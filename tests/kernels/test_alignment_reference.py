"""Alignment, nearest surfaces, ratios and outlines in the reference against the formulas of the contract, as loops."""

import math
from functools import cache
from itertools import product
from types import SimpleNamespace

import alignment_checks
import numpy as np
import pytest
from alignment_checks import (
    ALIGNMENT_CASES,
    OUTLINE_CASES,
    RATIO_CASES,
    AlignmentCase,
    OutlineCase,
    RatioCase,
    alignment_inputs,
    outline_inputs,
    ratio_inputs,
)
from checks import Operation, compute
from test_reference import REFERENCE

from lfgpu.contract import half_window

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
    """Curvature and slope pixel by pixel: the definition in `lfgpu/contract`, written out."""
    height, width = i.disparity.shape
    others = [n for n, offset in enumerate(i.offsets.astype(float)) if math.hypot(*offset) > 1e-3]
    views = {n: i.scale * i.recorded[n].astype(float) for n in others} | {-1: i.image.astype(float)}

    def color(n: int, y: int, x: int) -> np.ndarray:
        return views[n][min(max(y, 0), height - 1), min(max(x, 0), width - 1)]

    @cache
    def feature(n: int, y: int, x: int) -> np.ndarray:
        across = (color(n, y, x + 1) - color(n, y, x - 1)) / 2
        down = (color(n, y + 1, x) - color(n, y - 1, x)) / 2
        return np.array([color(n, y, x), across, down])

    @cache
    def gradient(n: int, y: int, x: int) -> np.ndarray:
        across = (feature(n, y, x + 1) - feature(n, y, x - 1)) / 2
        down = (feature(n, y + 1, x) - feature(n, y - 1, x)) / 2
        return np.array([across, down])

    def weight_of_gradients(y: int, x: int) -> float:
        around = list(product(range(max(0, y - 2), min(height, y + 3)), range(max(0, x - 2), min(width, x + 3))))
        steps = [
            np.abs(color(-1, *p) - color(-1, *q)).mean()
            for p, q in product(around, around)
            if abs(p[0] - q[0]) + abs(p[1] - q[1]) == 1
        ]
        return float(i.gradient_weight / (1 + (max(steps, default=0.0) / i.contrast) ** 2))

    def weight(residual: np.ndarray) -> float:
        return float(1 / (1 + (residual**2).mean() / i.robust**2) ** 2)

    curvature, slope = np.zeros((height, width)), np.zeros((height, width))
    for py, px in np.ndindex(height, width):
        d, seen = float(i.disparity[py, px]), []
        w = weight_of_gradients(py, px)
        features = np.array([1.0, w, w])[:, None]
        for n in others:
            x, y = px - d * float(i.offsets[n, 0]), py - d * float(i.offsets[n, 1])
            if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
                continue
            pixel = n, math.floor(y + 0.5), math.floor(x + 0.5)
            if (i.valid is not None and i.valid[pixel] == 0) or d < float(i.nearest[pixel]) - i.tolerance:
                continue
            left, top = math.floor(x), math.floor(y)
            f, g = np.zeros(()), np.zeros(())
            for ty, tx in product((top, top + 1), (left, left + 1)):
                share = (1 - abs(x - tx)) * (1 - abs(y - ty))
                f = share * features * feature(n, ty, tx) + f
                g = share * features * gradient(n, ty, tx) + g
            seen.append((i.offsets[n].astype(float), f, g))
        own, own_gradient = features * feature(-1, py, px), features * gradient(-1, py, px)
        shares = [weight(f - own) for _, f, _ in seen]
        mean = (own + sum(k * f for k, (_, f, _) in zip(shares, seen, strict=True))) / (1 + sum(shares))
        shares = [weight(f - mean) for _, f, _ in seen]
        total = own_gradient + sum(k * g for k, (_, _, g) in zip(shares, seen, strict=True))
        across, down = total / (1 + sum(shares))
        for k, ((du, dv), f, _) in zip(shares, seen, strict=True):
            change = -(du * across + dv * down)
            curvature[py, px] += k * (change**2).mean() / len(others)
            slope[py, px] -= k * (change * (f - mean)).mean() / len(others)
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


@pytest.mark.parametrize("case", [case for case in RATIO_CASES if math.prod(case.size) <= 400], ids=str)
def test_nlm_plane_is_the_least_squares(case: RatioCase, rng: np.random.Generator) -> None:
    """The ridge is two more equations, slope = 0, with the weight of all pixels together."""
    i = ratio_inputs(case, rng)
    (height, width), values = case.size, i.guide.astype(float)
    certainty = (i.denominator + i.options["floor"]).astype(float)
    got = run(alignment_checks.PLANE, i)["plane"]
    steps = [(k, dy, dx) for k, (dy, dx) in enumerate(half_window(case.window))]
    for y, x in np.ndindex(height, width):
        rows, right, weight = [(1.0, 0.0, 0.0)], [values[y, x]], [certainty[y, x]]
        for (k, dy, dx), sign in product(steps, (1, -1)):
            q = y + sign * dy, x + sign * dx
            if 0 <= q[0] < height and 0 <= q[1] < width:
                w = float(i.weights[k][(y, x) if sign > 0 else q])
                weight.append(certainty[q] * w / (1 + (values[q] - values[y, x]) ** 2 / case.support**2))
                rows.append((1.0, sign * dx, sign * dy))
                right.append(values[q])
        root = np.sqrt([*weight, *2 * [case.ridge * sum(weight)]])
        equations = root[:, None] * np.array([*rows, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
        want = np.linalg.lstsq(equations, root * np.array([*right, 0.0, 0.0]), rcond=None)[0][0]
        np.testing.assert_allclose(got[y, x], want, rtol=0, atol=1e-10)


@pytest.mark.parametrize("case", RATIO_CASES[:-1], ids=str)
def test_weights_on_a_surface_are_those_of_the_ratio(case: RatioCase, rng: np.random.Generator) -> None:
    """The ratio with a numerator of 1 at one pixel and denominators that make all pixels count alike."""
    i = ratio_inputs(case, rng)
    got = run(alignment_checks.ON_SURFACE, i)["weights"]
    guide, (height, width) = i.guide.astype(float), case.size
    for y, x in np.ndindex(height, width):
        for k, (dy, dx) in enumerate(half_window(case.window)):
            qy, qx = y + dy, x + dx
            want = 0.0
            if 0 <= qy < height and 0 <= qx < width:
                want = float(i.weights[k, y, x]) / (1 + ((guide[qy, qx] - guide[y, x]) / case.support) ** 2)
            assert got[k, y, x] == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("case", [case for case in OUTLINE_CASES if math.prod(case.size) < 400], ids=str)
def test_outlines_are_what_looking_at_each_pixel_says(case: OutlineCase, rng: np.random.Generator) -> None:
    i = outline_inputs(case, rng)
    got = run(alignment_checks.UNMIX, i)["disparity"]
    light, d, (height, width) = i.image.astype(float) ** 2, i.disparity.astype(float), case.size

    def around(y: int, x: int, reach: int) -> list[tuple[int, int]]:
        rows, columns = range(max(0, y - reach), y + reach + 1), range(max(0, x - reach), x + reach + 1)
        return [(qy, qx) for qy, qx in product(rows, columns) if qy < height and qx < width and (qy, qx) != (y, x)]

    for y, x in np.ndindex(height, width):
        front: list[tuple[float, np.ndarray, np.ndarray]] = []
        behind: list[tuple[float, np.ndarray, float]] = []
        for q in around(y, x, 3):
            away = (q[0] - y) ** 2 + (q[1] - x) ** 2
            if away > 9:
                continue
            weight = math.exp(-away / 3)
            if abs(d[q] - d[y, x]) <= case.step and all(d[q] - d[r] <= case.step for r in around(*q, 1)):
                front.append((weight, np.array([q[0] - y, q[1] - x]), light[q]))
            if d[q] < d[y, x] - case.step:
                beside = any(d[r] - d[q] > case.step for r in around(*q, 1))
                behind.append((weight * (1e-3 if beside else 1), light[q], d[q]))
        want = d[y, x]
        if front and behind and any(d[y, x] - d[r] > case.step for r in around(y, x, 1)):
            total = sum(b[0] for b in behind)
            weights = np.array([f[0] for f in front]) / sum(f[0] for f in front)
            places, lights = np.array([f[1] for f in front]), np.array([f[2] for f in front])
            middle, mean = weights @ places, weights @ lights
            spread = (weights[:, None] * (places - middle)).T @ (places - middle) + 0.3 * np.eye(2)
            together = (weights[:, None] * (places - middle)).T @ (lights - mean)
            nearer = np.maximum(mean - middle @ np.linalg.solve(spread, together), 0)
            back = sum(b[0] * b[1] for b in behind) / total
            little = (light[y, x] - back) @ (nearer - back) < case.share * ((nearer - back) ** 2).sum()
            if little and ((np.sqrt(nearer) - np.sqrt(back)) ** 2).sum() > case.channels * case.contrast**2:
                want = sum(b[0] * b[2] for b in behind) / total
        assert got[y, x] == pytest.approx(want, abs=1e-9)


def test_a_pixel_that_shows_little_of_what_is_nearer_belongs_to_what_is_behind() -> None:
    """A column of mixtures of light, estimated as what is nearer: it goes by how much of that it shows."""
    shares = np.linspace(0, 1, 11)
    image = np.zeros((11, 9, 1), np.float32)
    image[:, 5:] = 1
    image[:, 4, 0] = np.sqrt(shares)
    disparity = np.where(np.arange(9) >= 4, 1.0, -1.0) * np.ones((11, 1))
    i = SimpleNamespace(
        image=image, disparity=disparity.astype(np.float32), options={"step": 0.5, "contrast": 0.1, "share": 0.45}
    )
    got = run(alignment_checks.UNMIX, i)["disparity"]
    np.testing.assert_allclose(got[:, 4], np.where(shares < 0.45, -1, 1), atol=1e-9)
    rest = np.arange(9) != 4
    np.testing.assert_array_equal(got[:, rest], disparity[:, rest])


def test_what_is_nearer_may_get_darker_towards_its_outline() -> None:
    """A surface whose light goes down by the pixel, whole up to its outline: its colour there is taken on from inside.

    With the mean of its pixels instead, its last pixel shows 0.43 of it, and would go to what is behind.
    """
    light = np.array([0, 0, 0, 0, 1, 2, 3, 4, 5, 6]) / 6
    image = np.sqrt(np.broadcast_to(light[:, None], (9, 10, 1))).astype(np.float32)
    disparity = np.where(np.arange(10) >= 4, 1.0, -1.0) * np.ones((9, 1))
    i = SimpleNamespace(
        image=image, disparity=disparity.astype(np.float32), options={"step": 0.5, "contrast": 0.1, "share": 0.5}
    )
    np.testing.assert_array_equal(run(alignment_checks.UNMIX, i)["disparity"], disparity)
