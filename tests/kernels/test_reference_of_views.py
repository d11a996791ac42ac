"""Operations on views in the reference against loops: rectification, smoothing, range search, sectors, solvers."""

import itertools
import math
from dataclasses import replace
from typing import Any

import checks
import learned_checks as learned
import numpy as np
import pytest
import smoothing_checks
import solver_checks
from checks import compute
from measuring_checks import GRAIN, MeasuringCase, measuring_inputs
from range_search_checks import AGREEING, COSTS, DETAILS, DISTINCT, SHRINK, RangeSearchCase, range_search_inputs
from resampling_checks import RESAMPLE, ResamplingCase, resampling_inputs
from smoothing_checks import REDUCTION_CASES, SMOOTHING_CASES, SmoothingCase, smoothing_inputs
from test_reference import REFERENCE

from lfgpu.contract import UNSEEN, bridged, sectors_of

SMALL_SECTORS = [case for case in learned.SECTOR_CASES if math.prod(case.size) * len(case.offsets) <= 1500]
SMALL_LAYERS = [case for case in learned.CONVOLUTION_CASES if math.prod(case.size) <= 240 and case.stored == "float32"]


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
def test_costs_are_those_of_each_sector(case: learned.SectorCase, rng: np.random.Generator) -> None:
    i = learned.sector_inputs(case, rng)
    got = compute(REFERENCE, "cpu", learned.SECTOR_COSTS, i)["costs"]
    for _ in range(12):
        label = int(rng.integers(len(got)))
        y, x = (int(rng.integers(2 * side)) for side in i.folded)
        row, column = min(y, case.size[0] - 1), min(x, case.size[1] - 1)
        d = float(i.first[row, column]) + label * case.step
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


def test_sectors_and_references_are_in_order() -> None:
    offsets = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (0, 0), (5, 2), (5, -2.1), (1, 3)]
    assert sectors_of(np.array(offsets)).tolist() == [0, 1, 2, 3, 4, 5, 6, 7, -1, 0, 7, 2]
    for mean, want in ((0.32, 1.0), (0.0, 4.0), (1.0, 0.5), (0.12, 2.0)):
        factor = np.zeros(1)
        REFERENCE.brightness(np.full((3, 4, 3), mean), factor_out=factor)
        assert factor[0] == pytest.approx(want)
    image = np.arange(18.0).reshape(2, 3, 3)
    out = np.full((1, 1, 2, 16), np.nan)
    REFERENCE.fold(image, np.array([2.0]), folded_out=out)
    want = [0, 6, 18, 24, 2, 8, 20, 26, 4, 10, 22, 28, 0, 0, 0, 0]
    assert out[0, 0, 0].tolist() == want
    assert out[0, 0, 1, :4].tolist() == [12, 12, 30, 30]
    REFERENCE.fold(image[..., :1], np.array([1.0]), folded_out=out)
    assert out[0, 0, 0].tolist() == 3 * [0, 3, 9, 12] + [0, 0, 0, 0]


@pytest.mark.parametrize("case", SMALL_LAYERS, ids=str)
def test_convolution_is_that_of_each_voxel(case: learned.ConvolutionCase, rng: np.random.Generator) -> None:
    i = learned.convolution_inputs(case, rng)
    got = compute(REFERENCE, "cpu", learned.CONVOLUTION, i)["result"]
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


@pytest.mark.parametrize("case", learned.PEAK_CASES, ids=str)
def test_peak_is_that_of_each_pixel(case: learned.PeakCase, rng: np.random.Generator) -> None:
    i = learned.peak_inputs(case, rng)
    got = compute(REFERENCE, "cpu", learned.PEAK, i)
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


SMALL = [case for case in SMOOTHING_CASES if math.prod(case.size) <= 200]
REDUCED = [case for case in REDUCTION_CASES if math.prod(case.size) <= 500]


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


def test_single_masked_pixels_and_lines_are_bridged_by_valid_ones_alone() -> None:
    mask = np.ones((5, 6), np.bool_)
    mask[1, 1] = mask[0, 4] = mask[4, :2] = mask[2:4, 3:5] = mask[:, 5] = False
    view = np.where(mask, 10.0 * np.arange(5)[:, None] ** 2 + np.arange(6) ** 2, np.nan)[..., None]
    image = np.empty_like(view)
    REFERENCE.intensities(view[None], 0, mask[None], scale=2.0, fill=-1.0, image_out=image)
    expected = np.where(mask, 2 * view[..., 0], -1)  # two by two pixels, corners and borders have no two sides
    expected[1, 1] = 2 * (10 + 14 + 1 + 41) / 4
    np.testing.assert_allclose(image[..., 0], expected)
    assert ((image[..., 0] != -1) == bridged(mask)).all()


def test_masks_of_blocks_leave_something_to_decide(rng: np.random.Generator) -> None:
    """All valid, none and some: of each there are blocks, so that none of them is taken for another."""
    (case,) = (case for case in REDUCTION_CASES if case.name == "work for several threads")
    blocks = smoothing_inputs(case, rng).by_block[:, :60, :36].reshape(case.count, 15, 4, 9, 4) != 0
    every, some = blocks.all((2, 4)), blocks.any((2, 4))
    assert min(every.mean(), (some & ~every).mean(), (~some).mean()) > 0.05


def quadratic_of(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, solver_checks.Function]:
    """A, b, and xᵀ A x / 2 - bᵀ x with its gradient."""
    matrix, aim = solver_checks.quadratic(count, rng)

    def function(x: np.ndarray) -> tuple[float, np.ndarray]:
        gradient = matrix @ x.ravel() - aim
        return float(x.ravel() @ (gradient - aim)) / 2, gradient.reshape(x.shape)

    return matrix, aim, function


def test_lbfgs_direction_is_that_of_the_dense_update(rng: np.random.Generator) -> None:
    """BFGS written out: H ← (1 - s yᵀ / yᵀ s) H (1 - y sᵀ / yᵀ s) + s sᵀ / yᵀ s, from H = (sᵀ y / yᵀ y) 1."""
    *_, function = quadratic_of(12, rng)
    options = {"low": -100.0, "high": 100.0, "first_step": 0.05, "tolerance": 0.0, "patience": 100, "most": 100}
    solver = REFERENCE.lbfgs((3, 4), "cpu", memory=5, **options)
    x, trial = rng.normal(size=(3, 4)), np.empty((3, 4))
    value, gradient = function(x)
    held = np.array([value])
    solver.begin(x, gradient, held)
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(4):
        before, slope = x.copy().ravel(), gradient.copy().ravel()
        solver.propose(x, trial)
        trial_value, trial_gradient = function(trial)
        solver.judge(held, np.array([trial_value]))
        solver.learn(x, gradient, trial, trial_gradient)
        if (x.ravel() != before).any():
            pairs.append((x.ravel() - before, gradient.ravel() - slope))
    s, y = pairs[-1]
    inverse = np.eye(12) * (s @ y) / (y @ y)
    for s, y in pairs:
        left = np.eye(12) - np.outer(s, y) / (s @ y)
        inverse = left @ inverse @ left.T + np.outer(s, s) / (s @ y)
    solver.propose(x, trial)
    np.testing.assert_allclose((trial - x).ravel(), -inverse @ gradient.ravel(), rtol=1e-9, atol=1e-12)


def test_lbfgs_shortens_to_the_minimum_of_the_parabola() -> None:
    """From 1 along -2, by a step of 0.8 with the slope -4; what the solver is told about the trials is not accepted."""
    options = {"low": -9.0, "high": 9.0, "tolerance": 0.0, "patience": 3, "most": 9}
    solver = REFERENCE.lbfgs((1, 1), "cpu", memory=3, first_step=1.6, **options)
    x, gradient, trial, value = np.ones((1, 1)), np.full((1, 1), 2.0), np.empty((1, 1)), np.array([1.0])
    solver.begin(x, gradient, value)
    solver.propose(x, trial)
    assert trial[0, 0] == pytest.approx(1 - 1.6)
    solver.judge(value, np.array([2.0]))  # 1 - 4 t + a t² is 2 at t = 0.8: a = 6.5625, least at 4 / (2 a)
    solver.propose(x, trial)
    assert trial[0, 0] == pytest.approx(1 - 2 * 4 / (2 * 6.5625))
    solver.judge(value, np.array([np.inf]))
    solver.propose(x, trial)
    assert trial[0, 0] == pytest.approx(1 - 0.1 * 2 * 4 / (2 * 6.5625))
    assert solver.report() == ([1.0], 3, False)


def test_residuals_are_relative_roots() -> None:
    trace = REFERENCE.residuals("cpu", tolerance=0.25, most=3)
    trace.begin(np.array([4.0]))
    going = []
    for residual in (4.0, 1.0, 0.25):
        trace.add(np.array([residual]))
        going.append(float(trace.go_on[0]))
    assert trace.report() == [1.0, 0.5, 0.25]
    assert going == [1.0, 1.0, 0.0]


SEARCH_CASE = RangeSearchCase("any", size=(17, 19), masked=True)
ASKEW = replace(SEARCH_CASE, size=(25, 27), lines=((((-1.0, -0.5), (-2.0, -1.0)), ((1.0, 0.5),)),), count=5)


def run(operation: checks.Operation, case: RangeSearchCase, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
    inputs = range_search_inputs(case, rng)
    return inputs, checks.compute(REFERENCE, "cpu", operation, inputs)


def test_shrink_is_the_mean_of_blocks(rng: np.random.Generator) -> None:
    i, got = run(SHRINK, SEARCH_CASE, rng)
    assert 0 < got["known"].mean() < 1
    for k, y, x in np.ndindex(got["values"].shape):
        rows, columns = (range(i.factor * at, i.factor * (at + 1)) for at in (y, x))
        block = [(row, column) for row in rows for column in columns]
        values = [float(value) for row, column in block for value in i.views[i.chosen[k], row, column]]
        assert got["known"][k, y, x] == all(i.valid[k, row, column] != 0 for row, column in block)
        if got["known"][k, y, x]:
            assert got["values"][k, y, x] == pytest.approx(i.scale * sum(values) / len(values), rel=1e-12)


@pytest.mark.parametrize("factor", [1, 2])
def test_details_are_without_their_mean(factor: int, rng: np.random.Generator) -> None:
    i, got = run(DETAILS, replace(SEARCH_CASE, factor=factor), rng)
    height, width = i.small
    images = i.images[:, : factor * height, : factor * width].astype(np.float64)
    images = sum(images[:, dy::factor, dx::factor] for dy in range(factor) for dx in range(factor)) / factor**2
    for n, y, x in np.ndindex(got["values"].shape):
        around = range(-(i.window // 2), i.window // 2 + 1)
        places = [(min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)) for dy in around for dx in around]
        near = [images[n, row, column] for row, column in places if not math.isnan(images[n, row, column])]
        assert got["known"][n, y, x] != math.isnan(images[n, y, x])
        if got["known"][n, y, x]:
            assert got["values"][n, y, x] == pytest.approx(images[n, y, x] - sum(near) / len(near), abs=1e-12)


@pytest.mark.parametrize("case", [SEARCH_CASE, ASKEW], ids=["cross", "askew"])
def test_costs_are_means_of_differences(case: RangeSearchCase, rng: np.random.Generator) -> None:
    i, got = run(COSTS, case, rng)
    height, width = i.small

    def shown(view: int, x: float, y: float) -> float:
        """The detail of a view at a place, NaN outside."""
        total = 0.0
        for row, column in itertools.product((math.floor(y), math.ceil(y)), (math.floor(x), math.ceil(x))):
            weight = (1 - abs(y - row)) * (1 - abs(x - column))
            inside = 0 <= row < height and 0 <= column < width
            total += weight * float(i.details[view, row, column]) if inside else math.nan
        rows, columns = len({math.floor(y), math.ceil(y)}), len({math.floor(x), math.ceil(x)})
        return total * (rows * columns / 4)  # a place in a row or a column of pixels was counted more than once

    seen = 0
    for m, label, y, x in np.ndindex(len(i.lines), case.count, height, width):
        if (y + 2 * x + label) % 7:
            continue
        disparity, costs = case.first + case.step * label, []
        for side in i.lines[m]:
            terms = []
            for view, dy, dx in itertools.product(side, (-1, 0, 1), (-1, 0, 1)):
                if 0 <= y + dy < height and 0 <= x + dx < width:
                    du, dv = i.offsets[view]
                    there = shown(view, x + dx - disparity * du, y + dy - disparity * dv)
                    terms.append(abs(there - float(i.details[0, y + dy, x + dx])))
            terms = [term for term in terms if not math.isnan(term)]
            costs.append(sum(terms) / len(terms) if len(terms) >= 4.5 * len(side) else UNSEEN)
        seen += min(costs) < UNSEEN
        assert got["volume"][m, label, y, x] == pytest.approx(min(costs), abs=1e-12)
    assert seen > 20


def test_the_distinct_minimum_is_that_of_a_loop(rng: np.random.Generator) -> None:
    i, got = run(DISTINCT, SEARCH_CASE, rng)
    count = SEARCH_CASE.count
    for y, x in np.ndindex(*i.small):
        costs = [float(np.minimum(i.volume[:, label, y, x].astype(np.float64), 1).mean()) for label in range(count)]
        k = costs.index(min(costs))
        others = [cost for label, cost in enumerate(costs) if abs(label - k) > SEARCH_CASE.apart]
        place, least, other, worst = (got[name][y, x] for name in ("place", "least", "others", "worst"))
        assert got["known"][y, x] == (costs[k] < 1)
        assert (least, got["values"][y, x]) == (costs[k], max(costs) - costs[k] if costs[k] < 1 else 0)
        assert other == (min(others) - costs[k] if others else UNSEEN)
        if 0 < k < count - 1:
            before, here, next_ = costs[k - 1 : k + 2]
            bend = before - 2 * here + next_
            assert place == pytest.approx(k + ((before - next_) / (2 * bend) if bend > 1e-9 else 0))
            assert worst == i.volume[:, k, y, x].max()
        else:
            assert (place, worst) == (k, UNSEEN)


def test_pixels_agree_as_a_loop_says(rng: np.random.Generator) -> None:
    i, got = run(AGREEING, SEARCH_CASE, rng)
    place, _, _, others, worst = i.found
    height, width = i.small

    def said(y: int, x: int, noise: float) -> float | None:
        """The disparity of a pixel that is sure of it."""
        inside = 0 <= y < height and 0 <= x < width
        is_sure = inside and worst[y, x] <= min(4 * noise, 1) and others[y, x] >= 1.5 * noise
        return SEARCH_CASE.first + SEARCH_CASE.step * place[y, x] if is_sure else None

    noises = {"0.0625": 1 / 16, "0.5": 1 / 2, "nan": 1 / 32}
    for (y, x), (name, noise) in itertools.product(np.ndindex(height, width), noises.items()):
        here, near = said(y, x, noise), []
        if here is not None:
            near = [said(y + dy, x + dx, noise) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
            near = [one for one in near if one is not None and abs(one - here) <= 1.5 * SEARCH_CASE.step]
        assert got[f"known at {name}"][y, x] == (len(near) > 2)
        assert got[f"values at {name}"][y, x] == pytest.approx(sum(near) / len(near) if len(near) > 2 else 0)
    assert 0 < got["known at 0.5"].mean() < 1


def test_grain_is_that_of_windows_without_limits(rng: np.random.Generator) -> None:
    case = MeasuringCase("any", size=(16, 18), unknown=0.0)
    i = measuring_inputs(case, rng)
    got = checks.compute(REFERENCE, "cpu", GRAIN, i)
    height, width = got["differences_out values"].shape
    for y, x in np.ndindex(height, width):
        block = i.image[y : y + 5, x : x + 5].astype(np.float64)
        twice = np.abs(np.diff(np.diff(block, 4, axis=0), 4, axis=1)).mean()
        assert got["differences_out values"][y, x] == pytest.approx(math.sqrt(math.pi / 2) / 70 * twice, abs=1e-12)
        assert got["limited_out values"][y, x] == np.any((block == i.limits[0]) | (block == i.limits[1]))
    for y, x in np.ndindex(height - 6, width - 6):
        window = np.s_[y : y + 7, x : x + 7]
        mean = got["differences_out values"][window].mean()
        counts = mean > i.least_grain or not got["limited_out values"][window].any()
        assert got["grain_out known"][y + 3, x + 3] == counts
        assert got["grain_out values"][y + 3, x + 3] == pytest.approx(mean if counts else 0, abs=1e-12)
    assert 0 < got["grain_out known"].mean() < 1


@pytest.mark.parametrize("case", learned.CHOICE_CASES, ids=str)
def test_features_and_choices_are_those_of_each_pixel(case: learned.ChoiceCase, rng: np.random.Generator) -> None:
    i = learned.choice_inputs(case, rng)
    features = compute(REFERENCE, "cpu", learned.COMPARE_MAPS, i)["features"][0]
    chosen = compute(REFERENCE, "cpu", learned.CHOOSE, i)
    for _ in range(20):
        y, x = (int(rng.integers(2 * side)) for side in i.folded)
        inside = min(y, case.size[0] - 1), min(x, case.size[1] - 1)
        (d0, c0, v0, *means0), (d1, c1, v1, *means1) = ([float(values[inside]) for values in some] for some in i.maps)
        apart = case.farthest * (d1 - d0)
        want = [math.log((c + 1e-3) / (1.001 - c)) / 4 for c in (c0, c1)]
        want += [math.log(min(max(case.farthest * math.sqrt(v), 1e-3), 20)) / 3 for v in (v0, v1)]
        want += [math.asinh(20 * apart) / 4, math.log(1 + abs(apart) / 0.03) / 4]
        for near in zip(means0, means1, strict=True):
            want += [math.asinh(10 * case.farthest * (d - m)) / 4 for d, m in zip((d0, d1), near, strict=True)]
        want += [math.log(case.farthest) / 2, math.log(1 + 2.5 * case.farthest) / 4]
        folded = features[y // 2, x // 2].reshape(len(want), 2, 2)
        np.testing.assert_allclose(folded[:, y % 2, x % 2], want, atol=1e-9)
        if (y, x) != inside:
            continue
        choice, right, size = i.decisions[0, y // 2, x // 2].reshape(3, 2, 2)[:, y % 2, x % 2]
        share = 1 / (1 + math.exp(-choice))
        share = share if abs(apart) < 0.5 else round(share)
        assert chosen["disparity"][inside] == pytest.approx((1 - share) * d0 + share * d1)
        assert chosen["confidence"][inside] == pytest.approx(1 / (1 + math.exp(-right)))
        deviation = math.exp(min(max(size, -7), 4)) / case.farthest
        assert chosen["variance"][inside] == pytest.approx(deviation**2)


@pytest.mark.parametrize("case", learned.FACET_CASES, ids=str)
def test_planes_are_those_of_least_squares_and_facets_the_best_of_them(
    case: learned.FacetCase, rng: np.random.Generator
) -> None:
    i, reach = learned.facet_inputs(case, rng), 2
    height, width = case.size
    found = compute(REFERENCE, "cpu", learned.PLANES, i)
    best = compute(REFERENCE, "cpu", learned.FACETS, i)["facets"]
    for _ in range(20):
        y, x = int(rng.integers(height)), int(rng.integers(width))
        near = [
            (j, k)
            for j in range(max(y - reach, 0), min(y + reach + 1, height))
            for k in range(max(x - reach, 0), min(x + reach + 1, width))
        ]
        places = np.array([(1.0, k - x, j - y) for j, k in near])
        values = np.array([i.map_[place] for place in near], np.float64)
        # Of a single row or column, whose slope is free, the solution of least norm has the slope 0.
        numbers = np.linalg.lstsq(places, values, rcond=None)[0]
        got = [found[name][y, x] for name in ("level", "x", "y")]
        np.testing.assert_allclose(got, numbers, atol=1e-9)
        assert found["rest"][y, x] == pytest.approx(np.mean((values - places @ numbers) ** 2), abs=1e-12)
        value, by_x, by_y, _ = min((i.planes[place] for place in near), key=lambda plane: plane[3])
        j, k = min(near, key=lambda place: i.planes[place][3])
        assert best[y, x] == pytest.approx(value + by_x * (x - k) + by_y * (y - j), abs=1e-6)
