"""The first estimate: its filters, its accuracy from any reference view, its range, what it refuses."""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import LocalEstimator, structure_filters
from lfgpu.metrics import Metrics, evaluate

WARP = load("warp")
RANGE, WIDE = (-1.5, 1.5), (-3.0, 3.0)


@cache
def relief(**options: Any) -> LightField:
    return scenes.make("relief", **({"grid": (7, 7), "size": (96, 96)} | options))


class Local(NamedTuple):
    """The maps that the estimator leaves on the device, [y, x]."""

    disparity: np.ndarray
    coherence: np.ndarray


def estimated(lf: LightField, disparity_range: tuple[float, float] = RANGE, **config: float) -> Local:
    return run(LocalEstimator(lf.layout, disparity_range, LocalConfig(**config), Device(WARP, "cpu")), lf.views)


def run(estimator: LocalEstimator, views: np.ndarray) -> Local:
    estimator.run(WARP.image(views, "cpu"))
    return Local(WARP.numpy(estimator.disparity), WARP.numpy(estimator.coherence))


def score(lf: LightField, local: Local) -> Metrics:
    truth = lf.reference_truth()
    assert truth is not None
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


def test_nearer_views_count_more() -> None:
    filters = structure_filters(np.arange(-4.0, 5.0), LocalConfig())
    for weights in (filters.along_value[len(filters.along_outer) // 2], filters.along_outer, filters.across_value):
        assert weights.argmax() == len(weights) // 2
        assert (weights >= 0).all()


# --- accuracy ---


@pytest.mark.parametrize("seed", range(3))
def test_relief_is_found(seed: int) -> None:
    lf = relief(seed=seed)
    found = score(lf, estimated(lf))
    assert found.rmse < 0.03
    assert found.undefined < 1


@pytest.mark.parametrize("seed", range(2))
def test_wide_disparities_are_found_by_shearing(seed: int) -> None:
    lf = relief(seed=seed, disparity_range=WIDE)
    found = score(lf, estimated(lf, WIDE))
    assert found.rmse < 0.035
    assert found.undefined < 1


def test_a_missing_view_in_the_row_is_no_gap() -> None:
    full = relief()
    lf = full.subset([index for index in range(49) if index != full.index_of(3, 4)])
    assert score(lf, estimated(lf)).rmse < 0.04


def test_steps_of_shear_that_are_no_whole_numbers_will_do() -> None:
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


def test_estimator_remembers_nothing_of_the_views_before() -> None:
    """Although it keeps the best so far of one line and shear after the other."""
    lf, other = relief(), relief(seed=1)
    estimator = LocalEstimator(lf.layout, RANGE, LocalConfig(), Device(WARP, "cpu"))
    first, _, again = (run(estimator, views) for views in (lf.views, other.views, lf.views))
    np.testing.assert_array_equal(first.disparity, again.disparity)
    np.testing.assert_array_equal(first.coherence, again.coherence)


# --- what is undefined, and the bounds ---


def test_coherence_is_0_or_above_the_threshold() -> None:
    lf = scenes.make("textureless", grid=(5, 5), size=(64, 64))
    for threshold in (0.5, 0.8, 0.95):
        coherence = estimated(lf, coherence_threshold=threshold).coherence
        defined = coherence[coherence > 0]
        assert threshold <= defined.min() < defined.max() <= 1 + 1e-6
        assert defined.size < coherence.size


def test_a_higher_threshold_leaves_fewer_and_better_pixels() -> None:
    lf = scenes.make("boxes", grid=(7, 7), size=(96, 96))
    low, high = (score(lf, estimated(lf, coherence_threshold=threshold)) for threshold in (0.3, 0.97))
    assert high.undefined > low.undefined + 1
    assert high.rmse < low.rmse


def test_estimates_lie_in_the_range() -> None:
    local = estimated(relief(), (-0.5, 0.75))
    defined = local.disparity[local.coherence > 0]
    assert defined.size > 500
    assert -0.5 <= defined.min() <= defined.max() <= 0.75


# --- errors ---


def test_a_range_without_any_estimate_is_refused() -> None:
    with pytest.raises(LightFieldError, match="no pixel has a coherent estimate within the disparity range"):
        lfgpu.estimate_depth(relief(), disparity_range=(7.0, 7.0001), config="paper")


# --- cameras that do not stand one step apart, and disparities out of the ordinary ---


def test_cameras_far_apart_are_as_accurate_in_their_own_steps() -> None:
    lf = scenes.make("relief", grid=(9, 9), size=(96, 96), disparity_range=(-0.4, 0.4))
    sparse = lf.subset([lf.index_of(row, column) for row in (0, 4, 8) for column in (0, 4, 8)])
    unit = replace(sparse, positions=sparse.positions / 4, grid_shape=None)
    one, other = estimated(sparse, (-0.5, 0.5)), estimated(unit, (-2.0, 2.0))
    np.testing.assert_allclose(4 * one.disparity, other.disparity, atol=1e-5)
    assert evaluate(one.disparity, lf.truth.disparity).rmse < 0.02  # type: ignore[union-attr]


def test_cameras_a_little_out_of_line_still_make_a_row() -> None:
    lf = relief()
    jitter = np.random.default_rng(0).uniform(-0.02, 0.02, lf.positions.shape)
    shaken = replace(lf, positions=lf.positions + jitter, grid_shape=None, truth=None)
    assert len(shaken.row()) == len(shaken.column()) == 7
    assert np.median(np.abs(estimated(shaken).disparity - estimated(lf).disparity)) < 0.02


def test_the_range_is_in_units_of_the_positions() -> None:
    """Positions counted in steps half as long: disparities half as large, margin included."""
    lf = scenes.make("boxes", grid=(3, 3), size=(64, 72), disparity_range=(-2.0, 3.0))
    halved = replace(lf, positions=2 * lf.positions, truth=None, grid_shape=None)
    device = Device(load("warp"), "cpu")
    assert np.allclose(2 * np.array(find_disparity_range(halved, device)), find_disparity_range(lf, device))
