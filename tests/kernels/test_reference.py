"""The reference backend against independent truths: the formulas written out as loops, and central differences."""

import itertools
import math
from types import SimpleNamespace

import checks
import local_checks
import nlm_checks
import numpy as np
import pytest
import splat_checks
import view_checks
from lfgpu.kernels.reference.splat import splat, tent, tent_slope

from lfgpu._backends import load
from lfgpu.contract import half_window
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import structure_filters

REFERENCE = load("reference")
SOFTNESSES = (0.02, 0.1, 0.25, 0.5)


def run(operation: checks.Operation, inputs: SimpleNamespace) -> dict[str, np.ndarray]:
    return checks.compute(REFERENCE, "cpu", operation, inputs)


def changed(inputs: SimpleNamespace, **values: object) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(inputs), **values})


# --- the tent ---


def tent_of_any(x: float, e: float) -> float:
    """Λ written out for every x: a triangle whose kinks are parabolas over 2 e."""
    x, s = abs(x), 1 / (1 - e)
    if x >= 1:
        return 0.0
    if x <= e:
        return 1 - s * x * x / (2 * e)
    if x >= 1 - e:
        return s * (1 - x) ** 2 / (2 * e)
    return (1 - s * e / 2) - s * (x - e)


@pytest.mark.parametrize("softness", SOFTNESSES)
def test_tent_is_the_formula(softness: float) -> None:
    a = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(tent(a, softness), [tent_of_any(x, softness) for x in a], rtol=0, atol=1e-14)


@pytest.mark.parametrize("softness", SOFTNESSES)
def test_tent_is_continuously_differentiable(softness: float) -> None:
    a = np.linspace(1e-6, 1 - 1e-6, 5003)
    differences = (tent(a + 1e-7, softness) - tent(a - 1e-7, softness)) / 2e-7
    np.testing.assert_allclose(tent_slope(a, softness), differences, rtol=0, atol=1e-5 + 1e-7 / softness)
    joints = np.array([0.0, softness, 1 - softness, 1.0])
    beside = joints + np.array([[-1e-9], [1e-9]])
    left, right = tent_slope(beside.clip(0, 1), softness)
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-6)
    assert np.abs(tent_slope(np.array([0.0, 1.0]), softness)).max() == 0  # so that it joins its mirror image and zero


# --- the splat ---


def predicted(i: SimpleNamespace) -> checks.Values:
    return splat(*(np.asarray(values, np.float64) for values in (i.image, i.disparity, i.offsets)), i.softness)


@pytest.mark.parametrize("case", [case for case in splat_checks.SPLAT_CASES if math.prod(case.size) <= 200], ids=str)
def test_splat_is_the_formula(case: splat_checks.SplatCase, rng: np.random.Generator) -> None:
    i = splat_checks.splat_inputs(case, rng)
    height, width = case.size
    offsets = i.offsets[:2]
    views = np.zeros((len(offsets), height, width, case.channels))
    for n, (du, dv) in enumerate(offsets.astype(float)):
        for py, px in np.ndindex(height, width):
            d = float(i.disparity[py, px])
            to_x = [tent_of_any(qx - (px - d * du), case.softness) for qx in range(width)]
            to_y = [tent_of_any(qy - (py - d * dv), case.softness) for qy in range(height)]
            views[n] += np.outer(to_y, to_x)[..., None] * i.image[py, px].astype(float)
    np.testing.assert_allclose(predicted(i)[:2], views, rtol=0, atol=1e-12)


def test_splat_of_a_constant_disparity_shifts_the_image_against_the_camera(rng: np.random.Generator) -> None:
    i = splat_checks.splat_inputs(
        splat_checks.SplatCase("shift", offsets=((1.0, 0.0), (0.0, -1.0)), disparities=(2.0, 2.0)), rng
    )
    right, up = predicted(i)
    np.testing.assert_array_equal(right[:, :-2], i.image[:, 2:])  # seen from the right, things are 2 further left
    np.testing.assert_array_equal(up[2:], i.image[:-2])


def test_data_term_is_the_sum_of_squares_over_valid_pixels(rng: np.random.Generator) -> None:
    i = splat_checks.splat_inputs(splat_checks.SplatCase("masked", masked=True, dtype="uint8"), rng)
    difference = predicted(i) - i.recorded / 255.0
    want = float((i.valid[..., None] * difference**2).sum())
    assert float(run(splat_checks.DATA_TERM, i)["value"]) == pytest.approx(want, rel=1e-12)


# --- the prior ---


def brute_weights(i: SimpleNamespace) -> np.ndarray:
    """w(p, q) for every two pixels, [p, q], as the text of kernels/reference/nlm.py says; 0 for those too far apart."""
    height, width, channels = i.image.shape
    o, image = SimpleNamespace(**i.options), i.image.astype(float)

    def pixel(y: int, x: int) -> np.ndarray:
        return image[min(max(y, 0), height - 1), min(max(x, 0), width - 1)]

    def distance(p: tuple[int, int], q: tuple[int, int]) -> float:
        total = 0.0
        for c in range(channels):
            total += ((pixel(*p)[c] - pixel(*q)[c]) / o.sigma_color) ** 2
            for dy, dx in ((0, 1), (1, 0)):
                slope_p, slope_q = ((pixel(y + dy, x + dx)[c] - pixel(y - dy, x - dx)[c]) / 2 for y, x in (p, q))
                total += ((slope_p - slope_q) / o.sigma_gradient) ** 2
        return total / channels

    weights = np.zeros((height * width, height * width))
    radius, patch = o.window // 2, range(-(o.patch // 2), o.patch // 2 + 1)
    for (py, px), (qy, qx) in itertools.product(np.ndindex(height, width), repeat=2):
        if max(abs(py - qy), abs(px - qx)) > radius or (py, px) == (qy, qx):
            continue
        both = [
            distance((py + dy, px + dx), (qy + dy, qx + dx))
            for dy, dx in itertools.product(patch, repeat=2)
            if min(py, qy) + dy >= 0
            and max(py, qy) + dy < height
            and min(px, qx) + dx >= 0
            and max(px, qx) + dx < width
        ]
        weights[py * width + px, qy * width + qx] = max(o.floor, math.exp(-sum(both) / len(both)))
    return weights


def dense(weights: np.ndarray, window: int) -> np.ndarray:
    """Weights of one half of a window as a matrix [p, q], symmetric."""
    _, height, width = weights.shape
    matrix = np.zeros((height * width, height * width))
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        for y, x in np.ndindex(height, width):
            if 0 <= y + dy < height and 0 <= x + dx < width:
                p, q = y * width + x, (y + dy) * width + x + dx
                matrix[p, q] = matrix[q, p] = w[y, x]
            else:
                assert w[y, x] == 0
    return matrix


TINY = (
    nlm_checks.NlmCase("colour", size=(5, 6), window=5),
    nlm_checks.NlmCase("grey", size=(6, 4), window=3, channels=1),
    nlm_checks.NlmCase("wide patch", size=(4, 6), window=7, patch=5),
    nlm_checks.NlmCase("single pixel patch", size=(5, 5), patch=1),
    nlm_checks.NlmCase("line", size=(1, 9), window=5),
    nlm_checks.NlmCase("floor", size=(5, 5), sigma_color=0.05, floor=0.1),
)


@pytest.mark.parametrize("case", TINY, ids=str)
def test_nlm_weights_are_the_formula(case: nlm_checks.NlmCase, rng: np.random.Generator) -> None:
    i = nlm_checks.nlm_inputs(case, rng)
    got = dense(run(nlm_checks.WEIGHTS, i)["weights"], case.window)
    np.testing.assert_allclose(got, brute_weights(i), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("case", TINY, ids=str)
def test_nlm_operators_are_their_matrices(case: nlm_checks.NlmCase, rng: np.random.Generator) -> None:
    i = nlm_checks.nlm_inputs(case, rng)
    w = dense(i.weights.astype(float), case.window)
    values = i.values.astype(float).ravel()
    np.testing.assert_allclose(run(nlm_checks.NEIGHBORS, i)["sums"].ravel(), w @ values + values, rtol=0, atol=1e-12)
    laplacian = np.diag(w.sum(1)) - w
    np.testing.assert_allclose(run(nlm_checks.LAPLACIAN, i)["laplacian"].ravel(), laplacian @ values, atol=1e-12)


# --- the local estimate ---


def moving_pattern(disparity: float, offsets: np.ndarray, *, width: int = 48, height: int = 4) -> np.ndarray:
    """EPIs [u, y, x, 1] of a smooth pattern I(x + d u) of that disparity, in [0, 1]."""
    x = np.arange(width) + disparity * offsets[:, None, None]
    y = np.arange(height)[None, :, None]
    waves = np.sin(0.31 * x + y) + np.sin(0.47 * x + 2 * y + 1) + np.sin(0.22 * x + 2)
    return (0.5 + waves / 6.5)[..., None]


def found_disparity(disparity: float, offsets: np.ndarray, shear: float) -> tuple[np.ndarray, np.ndarray]:
    """Disparity and coherence of a moving pattern, without what the filters and the shear bring in from the border."""
    filters = structure_filters(offsets, LocalConfig())
    epis = moving_pattern(disparity, offsets)
    plan = REFERENCE.structure_tensor(epis.shape, offsets, filters, scale=1.0, floor=1e-4)
    found, coherence = np.empty((2, 4, 48))
    plan(epis, shear, found, coherence)
    reach = 7 + 4 * math.ceil(abs(shear))
    return found[:, reach:-reach], coherence[:, reach:-reach]


DISPARITIES = [0.0, 0.25, -0.4, 0.5, 1.3, -2.25, 3.0]


@pytest.mark.parametrize("disparity", DISPARITIES)
def test_structure_tensor_finds_the_disparity_of_a_moving_pattern(disparity: float) -> None:
    found, coherence = found_disparity(disparity, np.arange(-4.0, 5.0), shear=round(disparity))
    assert np.abs(found - disparity).max() < 0.01
    assert coherence.min() > 0.99


@pytest.mark.parametrize("first", [0, -8], ids=["left", "right"])
@pytest.mark.parametrize("disparity", DISPARITIES)
def test_structure_tensor_finds_the_disparity_from_the_end_of_a_row(disparity: float, first: int) -> None:
    """Views on one side only: less exact, the more so the further the disparity is from the shear, but not biased."""
    found, coherence = found_disparity(disparity, first + np.arange(9.0), shear=round(2 * disparity) / 2)
    assert np.abs(found - disparity).max() < 0.12
    assert abs(np.mean(found - disparity)) < 0.02
    assert coherence.min() > 0.8


def test_coherence_lies_between_0_and_1(rng: np.random.Generator) -> None:
    offsets = np.arange(-3.0, 4.0)
    epis, filters = rng.random((7, 9, 30, 3)), structure_filters(offsets, LocalConfig())
    plan = REFERENCE.structure_tensor(epis.shape, offsets, filters, scale=1.0, floor=1e-3)
    found, coherence = np.empty((2, 9, 30))
    for shear in (-1.0, 0.0, 0.5):
        plan(epis, shear, found, coherence)
        assert coherence.min() >= 0
        assert coherence.max() <= 1
    assert coherence.min() < 0.5  # noise is not coherent everywhere
    filters = structure_filters(offsets, LocalConfig())
    plan = REFERENCE.structure_tensor((7, 5, 20, 1), offsets, filters, scale=1.0, floor=1e-3)
    found, coherence = np.empty((2, 5, 20))
    plan(np.full((7, 5, 20, 1), 0.4), 0.0, found, coherence)
    assert coherence.max() < 1e-12


def test_best_estimate_is_found_pixel_by_pixel(rng: np.random.Generator) -> None:
    for vertical in (False, True):
        case = local_checks.CoherenceCase("any", size=(6, 8), vertical=vertical, unit=2.0, bounds=(-0.25, 0.5))
        i = local_checks.coherence_inputs(case, rng)
        best, coherence = i.best_disparity.astype(float), i.best_coherence.astype(float)
        for estimate, (y, x) in itertools.product(i.estimates, np.ndindex(6, 8)):
            place = (x, y) if vertical else (y, x)
            found = float(estimate.disparity[place])
            near = abs(found - case.shear) <= case.reach and -0.25 <= found / 2 <= 0.5
            if near and estimate.trusted[place] and estimate.coherence[place] > coherence[y, x]:
                best[y, x], coherence[y, x] = found / 2, estimate.coherence[place]
        got = run(local_checks.KEEP_MORE_COHERENT, i)
        np.testing.assert_array_equal(got["disparity"], best)
        np.testing.assert_array_equal(got["coherence"], coherence)


# --- views ---


def gaussian_weights(size: int, sigma: float) -> np.ndarray:
    """The matrix [to, from] of the Gaussian mean along a line that is mirrored, its ends repeated."""
    reach = int(2.5 * sigma + 0.5)
    steps = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (steps / sigma) ** 2)
    matrix = np.zeros((size, size))
    for to, (step, weight) in itertools.product(range(size), zip(steps, kernel / kernel.sum(), strict=True)):
        place = (to + step) % (2 * size)
        matrix[to, min(place, 2 * size - 1 - place)] += weight
    return matrix


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("size", [(9, 12), (1, 7), (3, 4), (1, 1)], ids=str)
@pytest.mark.parametrize("sigma", [0.4, 1.5, 3.1])
def test_normalization_is_the_formula(
    sigma: float, size: tuple[int, int], masked: bool, rng: np.random.Generator
) -> None:
    case = view_checks.ViewsCase("any", size=size, sigma=sigma, masked=masked, dtype="uint8", floor=0.1)
    i = view_checks.views_inputs(case, rng)
    got = run(view_checks.NORMALIZATION, i)["detail"]
    for n, view in enumerate(i.views / 255.0):
        counts = np.ones(size) if i.valid is None else (i.valid[n] != 0).astype(float)

        def mean(values: np.ndarray, scale: float, counts: np.ndarray = counts) -> np.ndarray:
            """Σ w v / Σ w over the valid pixels, 0 where there is none."""
            rows, columns = (gaussian_weights(side, scale) for side in size)
            share = rows @ counts @ columns.T
            return np.divide(rows @ (counts * values) @ columns.T, share, out=np.zeros(size), where=share > 1e-6)

        detail = np.stack([view[..., c] - mean(view[..., c], sigma) for c in range(3)], axis=2)
        contrast = np.sqrt(mean((detail**2).mean(2), 2 * sigma) + 0.1**2)
        np.testing.assert_allclose(got[n], detail / contrast[..., None], rtol=0, atol=1e-11)


def test_views_are_seen_pixel_by_pixel(rng: np.random.Generator) -> None:
    i = splat_checks.seen_inputs(splat_checks.SplatCase("any", size=(5, 6), offsets=checks.IRREGULAR), rng)
    got = run(splat_checks.SEEN_BY_REFERENCE, i)
    for n, y, x in np.ndindex(got["both"].shape):
        at_x, at_y = (p + float(i.disparity[y, x]) * float(o) for p, o in zip((x, y), i.offsets[n], strict=True))
        inside = 0 <= at_x <= 5 and 0 <= at_y <= 4
        known = inside and bool(i.known[round(at_y), round(at_x)])  # Python, too, rounds halves to even
        assert got["anything"][n, y, x] == inside
        assert got["known"][n, y, x] == known
        assert got["valid"][n, y, x] == (inside and i.valid[n, y, x] != 0)
        assert got["both"][n, y, x] == (known and i.valid[n, y, x] != 0)
    # With the same disparity everywhere, a pixel that is seen is one that something lands on.
    i = splat_checks.seen_inputs(splat_checks.SplatCase("whole", disparities=(2.0, 2.0)), rng)
    i.image = np.ones_like(i.image)
    np.testing.assert_array_equal(run(splat_checks.SEEN_BY_REFERENCE, i)["anything"], predicted(i)[..., 0])
    i = view_checks.views_inputs(view_checks.ViewsCase("any", line=(2, 0)), rng)
    row = run(view_checks.LINE_OF_VIEWS, i)["epis"]
    column = run(view_checks.LINE_OF_VIEWS, changed(i, vertical=True))["epis"]
    np.testing.assert_array_equal(row, i.views[[2, 0]])
    np.testing.assert_array_equal(column, row.swapaxes(1, 2))
