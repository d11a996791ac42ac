"""The first estimate and its propagation: filters, accuracy from any view, normal equations written out, refusals."""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from solver_runs import Found

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.data import LightField
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.sections import LocalConfig, PriorConfig
from lfgpu.methods.structure_tensor import LocalEstimator, structure_filters
from lfgpu.methods.synthesis.config import PropagationConfig
from lfgpu.methods.synthesis.propagation import Propagation
from lfgpu.metrics import Metrics, evaluate

WARP = load("warp")
RANGE, WIDE = (-1.5, 1.5), (-3.0, 3.0)


@cache
def relief(**options: Any) -> LightField:
    return scenes.make("relief", **({"grid": (7, 7), "size": (96, 96)} | options))


class Local(NamedTuple):
    """A first estimate, maps [y, x]."""

    disparity: np.ndarray
    coherence: np.ndarray


def estimated(lf: LightField, disparity_range: tuple[float, float] = RANGE, **config: float) -> Local:
    return run(LocalEstimator(lf.layout, disparity_range, LocalConfig(**config), Device(WARP, "cpu")), lf.views)


def run(estimator: LocalEstimator, views: np.ndarray) -> Local:
    estimator.run(WARP.image(views, "cpu"))
    return Local(WARP.numpy(estimator.disparity), WARP.numpy(estimator.coherence))


def score(lf: LightField, local: Local) -> Metrics:
    truth = lf.reference_truth()
    return evaluate(np.where(local.coherence > 0, local.disparity, np.nan), truth.disparity)


# --- filters ---

OFFSETS = {
    "even": np.arange(-4.0, 5.0),
    "left end": np.arange(0.0, 7.0),
    "right end": np.arange(-6.0, 1.0),
    "irregular": np.array([-3.3, -1.9, -0.7, 0.0, 1.4, 2.2]),
    "two views": np.array([0.0, 1.0]),
    "far apart": np.array([-20.0, 0.0, 20.0]),
}


@pytest.mark.parametrize("offsets", OFFSETS.values(), ids=OFFSETS)
@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_filters_along_the_views_are_right_for_straight_lines(offsets: np.ndarray, scale: float) -> None:
    filters = structure_filters(offsets, LocalConfig(inner_scale=scale, outer_scale=1.0))
    line = 0.7 - 1.3 * offsets
    places = offsets[np.abs(offsets) <= 3.72]
    np.testing.assert_allclose(filters.along_slope @ line, -1.3, rtol=1e-12)
    np.testing.assert_allclose(filters.along_value @ line, 0.7 - 1.3 * places, rtol=1e-12)
    assert filters.along_outer.sum() == pytest.approx(1)
    assert len(filters.along_outer) == len(places)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_filters_across_the_views_are_right_for_straight_lines(scale: float) -> None:
    filters = structure_filters(np.arange(-3.0, 4.0), LocalConfig(inner_scale=scale, outer_scale=scale))
    x = np.arange(len(filters.across_value)) - len(filters.across_value) // 2
    assert (filters.across_value * (2 + 3 * x)).sum() == pytest.approx(2)
    assert (filters.across_slope * (2 + 3 * x)).sum() == pytest.approx(3)
    assert filters.across_outer.sum() == pytest.approx(1)
    np.testing.assert_allclose(filters.across_value, filters.across_value[::-1])


# --- accuracy ---


@pytest.mark.parametrize(("bounds", "most"), [(RANGE, 0.03), (WIDE, 0.035)], ids=["narrow", "wide"])
def test_relief_is_found(bounds: tuple[float, float], most: float) -> None:
    lf = relief(disparity_range=bounds)
    found = score(lf, estimated(lf, bounds))
    assert found.rmse < most
    assert found.undefined < 1


def test_any_steps_of_shear_and_rows_with_gaps_will_do() -> None:
    full = relief()
    lf = full.subset([index for index in range(49) if index != full.index_of(3, 4)])
    assert score(lf, estimated(lf)).rmse < 0.04
    lf = relief()
    assert score(lf, estimated(lf, shear_step=0.75)).rmse < 0.04


def test_masked_pixels_of_the_row_do_not_count() -> None:
    lf = relief()
    others = [index for index in lf.row() if index != lf.reference]
    valid, garbage = np.ones(lf.views.shape[:3], bool), lf.views.copy()
    valid[others, 30:50, 30:50] = False
    garbage[others, 30:50, 30:50] = 255
    one, other = (estimated(replace(lf, views=views, valid=valid)) for views in (lf.views, garbage))
    np.testing.assert_array_equal(one.disparity, other.disparity)


# --- what is undefined, and the bounds ---


def test_a_higher_threshold_leaves_fewer_and_better_pixels() -> None:
    lf = scenes.make("textureless", grid=(5, 5), size=(64, 64))
    for threshold in (0.5, 0.8, 0.95):
        coherence = estimated(lf, coherence_threshold=threshold).coherence
        defined = coherence[coherence > 0]
        assert threshold <= defined.min() < defined.max() <= 1 + 1e-6
        assert defined.size < coherence.size
    lf = scenes.make("boxes", grid=(7, 7), size=(96, 96))
    low, high = (score(lf, estimated(lf, coherence_threshold=threshold)) for threshold in (0.3, 0.97))
    assert high.undefined > low.undefined + 1
    assert high.rmse < low.rmse


# --- cameras that do not stand one step apart, and disparities out of the ordinary ---


def test_cameras_stand_in_steps_of_their_own() -> None:
    lf = scenes.make("relief", grid=(9, 9), size=(96, 96), disparity_range=(-0.4, 0.4))
    sparse = lf.subset([lf.index_of(row, column) for row in (0, 4, 8) for column in (0, 4, 8)])
    unit = replace(sparse, positions=sparse.positions / 4, grid_shape=None)
    one, other = estimated(sparse, (-0.5, 0.5)), estimated(unit, (-2.0, 2.0))
    np.testing.assert_allclose(4 * one.disparity, other.disparity, atol=1e-5)
    assert evaluate(one.disparity, lf.truth.disparity).rmse < 0.02  # type: ignore[union-attr]
    lf = relief()
    jitter = np.random.default_rng(0).uniform(-0.02, 0.02, lf.positions.shape)
    shaken = replace(lf, positions=lf.positions + jitter, grid_shape=None, truth=None)
    assert len(shaken.row()) == len(shaken.column()) == 7
    assert np.median(np.abs(estimated(shaken).disparity - estimated(lf).disparity)) < 0.02
    # Positions counted in steps half as long: disparities half as large, margin included.
    lf = scenes.make("boxes", grid=(3, 3), size=(64, 72), disparity_range=(-2.0, 3.0))
    halved = replace(lf, positions=2 * lf.positions, truth=None, grid_shape=None)
    device = Device(load("warp"), "cpu")
    assert np.allclose(2 * np.array(find_disparity_range(halved, device)), find_disparity_range(lf, device))


def test_views_beside_each_other_are_no_column() -> None:
    """Within the 0.1 view steps of a line, but without any distance along it."""
    lf = relief(grid=(1, 3))
    beside = replace(lf, positions=np.array([[-0.05, 0.0], [0.0, 0.0], [1.0, 0.0]]), grid_shape=None, truth=None)
    assert len(beside.column()) == 2
    estimator = LocalEstimator(beside.layout, RANGE, LocalConfig(), Device(WARP, "cpu"))
    assert set(estimator.by_line) == {"row"}
    apart = replace(beside.subset([0, 1]), positions=np.array([[0.0, 0.0], [0.0, 0.05]]))
    assert set(LocalEstimator(apart.layout, RANGE, LocalConfig(), Device(WARP, "cpu")).by_line) == {"column"}


PRIOR = PriorConfig(window=5, sigma_color=0.3, sigma_gradient=0.3)


def gappy(rng: np.random.Generator, size: tuple[int, int]) -> Local:
    coherence = np.where(rng.random(size) < 0.6, rng.uniform(0.8, 1.0, size), 0.0)
    return Local(rng.uniform(-1, 1, size).astype(np.float32), coherence.astype(np.float32))


def propagation_of(image: np.ndarray, kernels: Any, device: str, **options: Any) -> Propagation:
    prior = NonLocalMeans(image.shape, PRIOR, Device(kernels, device))
    prior.load(kernels.image(image, device))
    return Propagation(image.shape[:2], (-1.0, 1.0), prior, PropagationConfig(**options))


def propagated(local: Local, image: np.ndarray, target: Any, **options: Any) -> Found:
    kernels, device = target.kernels, target.device
    propagation = propagation_of(image, kernels, device, **options)
    propagation.run(kernels.field(local.disparity, device), kernels.field(local.coherence, device))
    return Found(kernels.numpy(propagation.filled), propagation.report())


def test_propagation_by_cg_and_by_lbfgsb_is_the_same(target: Any, rng: np.random.Generator) -> None:
    size = (14, 17)
    image, local = rng.random((*size, 3), np.float32), gappy(rng, size)
    by_cg = propagated(local, image, target, solver="cg", tolerance=1e-6)
    by_lbfgsb = propagated(local, image, target, solver="lbfgsb", tolerance=1e-8, max_iterations=2000)
    assert np.abs(by_cg.values - by_lbfgsb.values).max() < 1e-3
    assert by_cg.solution.converged  # L-BFGS-B may end at the last bit of float32 instead


def test_propagation_stays_within_what_was_defined(target: Any, rng: np.random.Generator) -> None:
    size = (14, 17)
    local = gappy(rng, size)
    values, _ = propagated(local, rng.random((*size, 1), np.float32), target, tolerance=1e-6)
    defined = local.disparity[local.coherence > 0]
    assert values.min() >= defined.min() - 1e-5
    assert values.max() <= defined.max() + 1e-5
    size = (9, 8)
    disparity, coherence = np.full(size, -7.0, np.float32), np.zeros(size, np.float32)
    disparity[4, 3], coherence[4, 3] = 0.625, 0.9
    values, _ = propagated(Local(disparity, coherence), rng.random((*size, 1), np.float32), target, tolerance=1e-6)
    np.testing.assert_allclose(values, 0.625, rtol=0, atol=1e-4)
    image, local = rng.random((*size, 1), np.float32), gappy(rng, size)
    other = Local(np.where(local.coherence > 0, local.disparity, np.float32(99)), local.coherence)
    a, b = (propagated(one, image, target, tolerance=1e-6).values for one in (local, other))
    np.testing.assert_array_equal(a, b)


def test_propagation_says_how_much_it_was_told(target: Any, rng: np.random.Generator) -> None:
    """`trusted` is what tells that there was nothing to go by."""
    kernels, device, size = target.kernels, target.device, (9, 8)
    propagation = propagation_of(rng.random((*size, 1), np.float32), kernels, device)
    some = gappy(rng, size)
    for coherence in (np.zeros(size), some.coherence, np.zeros(size)):
        propagation.run(kernels.field(some.disparity, device), kernels.field(coherence, device))
        assert kernels.number(propagation.trusted) == pytest.approx(coherence.sum(dtype=float), rel=1e-6)
        assert np.isfinite(kernels.numpy(propagation.filled)).all()
