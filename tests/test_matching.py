"""Matching: which views and disparities are compared, and how near the map comes to the truth."""

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.config import Config
from lfgpu.contract import Device
from lfgpu.data import DepthResult, LightField, ViewLayout
from lfgpu.methods import PRESETS, PresetName, method_of
from lfgpu.methods.matching.config import SweepConfig
from lfgpu.methods.matching.disparities import compared_disparities, compared_reach, view_sets
from lfgpu.methods.matching.noise import in_units_of, measured_grain, measured_noise
from lfgpu.methods.matching.views import are_around, compared_views, every_other_view, used_views
from lfgpu.methods.measured import exposure_of
from lfgpu.metrics import Metrics, evaluate, sparsification
from lfgpu.pipelines.estimate import estimate_depth
from tests.made import masked

RANGE = (-1.6, 1.7)


def grid(rows: int, columns: int) -> np.ndarray:
    v, u = np.mgrid[:rows, :columns]
    return np.stack([u - columns // 2, v - rows // 2], -1).reshape(-1, 2).astype(np.float64)


def layout_of(offsets: np.ndarray) -> ViewLayout:
    reference = int(np.abs(offsets).sum(1).argmin())
    return ViewLayout(offsets, reference, (8, 8), 1, np.dtype(np.uint8), 1 / 255)


def scene(name: str, *, views: int = 5, size: int = 96) -> LightField:
    return scenes.make(name, grid=(views, views), size=(size, size))


@cache
def estimated(name: str, preset: PresetName) -> DepthResult:
    return estimate_depth(scene(name, size=128), disparity_range=RANGE, config=preset)


def scores(name: str, preset: PresetName) -> dict[str, Metrics]:
    truth = scene(name, size=128).truth.disparity
    return {stage: evaluate(values, truth) for stage, values in estimated(name, preset).stages.items()}


@pytest.mark.parametrize("bounds", [(-1.5, 1.0), (-1.53, 1.08), (0.25, 0.99), (-3.15, -2.2)])
def test_disparities_are_at_odd_halves_of_a_step_and_cover_the_range(bounds: tuple[float, float]) -> None:
    found = compared_disparities(bounds, 4.0, SweepConfig(step=0.4))
    first, step, count = found.first, found.step, found.count
    last = first + step * (count - 1)
    assert step == pytest.approx(0.1)
    assert first / step - 0.5 == pytest.approx(round(first / step - 0.5))
    assert bounds[0] - step < first <= bounds[0] + 1e-6
    assert bounds[1] - 1e-6 <= last < bounds[1] + step


def test_a_wide_range_makes_the_steps_longer_and_a_narrow_one_still_has_three() -> None:
    for shift in np.linspace(0, 1, 7):
        found = compared_disparities((-50.0 + shift, 50.0 + shift), 4.0, SweepConfig(max_labels=102))
        assert found.step == 1.0
        assert found.count in (101, 102)
    few = compared_disparities((-50.0, 50.0), 4.0, SweepConfig(max_labels=3))
    assert (few.step, few.count) == (100.0, 3)
    assert compared_disparities((0.0, 1e-3), 1.0, SweepConfig()).count == 3


def test_views_near_the_reference_are_compared_where_the_range_is_wide() -> None:
    config = SweepConfig(step=0.5, max_labels=102)  # 50 px in the farthest view
    for width, reach in ((12.5, 4.0), (12.6, 3.0), (25.0, 2.0), (25.1, 1.0), (1000.0, 1.0)):
        assert compared_reach(grid(9, 9), (-5.0, width - 5.0), config) == reach
    assert compared_reach(grid(1, 9), (0.0, 50.0), config) == 2.0  # four views beside the reference
    assert compared_reach(grid(1, 3), (0.0, 50.0), config) == 1.0  # there are no more


WIDE = (-6.0, 6.0)


@pytest.mark.parametrize(("preset", "most"), [("fast", 3.5), ("accurate", 3.0)])
def test_a_wide_range_is_swept_near_the_reference_and_aligned_in_all_views(preset: PresetName, most: float) -> None:
    lf = scenes.make("planes", grid=(5, 5), size=(128, 128), disparity_range=WIDE)
    config = PRESETS[preset].with_values({"sweep.max_labels": 29})
    result = estimate_depth(lf, disparity_range=WIDE, config=config, device="cpu")
    assert evaluate(result.disparity, lf.reference_truth().disparity).badpix_07 < most
    assert not [note for note in result.notes if "disparities that are compared" in note]


@pytest.mark.parametrize(
    ("places", "columns"),
    [(grid(9, 9), [-4, -2, 0, 2, 4]), (grid(7, 7), [-3, -1, 0, 1, 3]), (grid(7, 8), [-4, -2, 0, 1, 3])],
)
def test_between_the_first_and_the_last_sweep_every_other_row_and_column_is_compared(
    places: np.ndarray, columns: list[int]
) -> None:
    """From the outermost ones to the reference's; in grids of less than 9 x 9 views they are what is swept."""
    swept = places[compared_views(layout_of(places), "alternate")]
    middle = swept[every_other_view(layout_of(swept), "alternate")]
    assert len(middle) == 25
    assert sorted(set(middle[:, 0])) == columns
    assert len(swept) == (41 if len(places) == 81 else 25)
    assert len(every_other_view(layout_of(swept), "full")) == len(swept)
    assert len(every_other_view(layout_of(grid(5, 5)), "alternate")) == 25
    beside = layout_of(places + np.linspace(0, 0.2, len(places))[:, None])
    assert len(compared_views(beside, "alternate")) == len(places)  # not on a grid
    assert len(compared_views(layout_of(grid(5, 5)), "alternate")) == 25  # 9 are too few


@pytest.mark.parametrize(
    ("places", "are"),
    [
        (grid(3, 3), True),
        (grid(9, 9), True),
        (np.array([[0, 0], [1, 0], [-1, 1], [-1, -1]]), True),
        (grid(1, 9), False),  # a row
        (grid(5, 5)[10:], False),  # below the reference and beside it
        (grid(3, 3)[4:], False),
        (np.array([[0, 0], [1, 1], [-1, -1], [2, 2]]), False),  # a diagonal
        (np.array([[0, 0], [1, 0]]), False),
    ],
)
def test_surfaces_are_widened_only_where_views_are_on_all_sides(places: np.ndarray, are: bool) -> None:
    assert are_around(np.asarray(places, np.float64)) == are


def test_what_is_above_something_near_stays_visible_in_a_row_of_views() -> None:
    """With widened surfaces it would be hidden from all views, and surfaces would grow sweep by sweep."""
    lf = scenes.make("planes", seed=11, grid=(1, 9), size=(96, 96), noise=0.01)
    maps = [
        estimate_depth(lf, disparity_range=RANGE, config=PRESETS["accurate"].with_values({"sweep.resweeps": count}))
        for count in (1, 3)
    ]
    np.testing.assert_array_equal(maps[0].disparity, maps[1].disparity)


def test_views_that_are_not_swept_change_the_last_step_only() -> None:
    """One view of the other colour is out of line: the sweeps stay as they are. Masks go with their views."""
    lf = scenes.make("planes", grid=(9, 9), size=(32, 40), seed=1)
    valid = np.ones(lf.views.shape[:3], np.bool_)
    valid[59] = False  # one to the right of the reference and two below, where no noise is measured
    moved = lf.views.copy()
    moved[59, :, 1:] = lf.views[59, :, :-1]
    options = {"config": "accurate", "disparity_range": RANGE, "device": "cpu"}
    before = estimate_depth(replace(lf, valid=valid), **options)
    after = estimate_depth(replace(lf, views=moved, valid=valid), **options)
    blind = estimate_depth(replace(lf, views=moved, valid=np.ones_like(valid)), **options)
    for stage in ("sweep", "resweep"):
        np.testing.assert_array_equal(blind.stages[stage], before.stages[stage])
    np.testing.assert_array_equal(after.disparity, before.disparity)
    assert np.abs(blind.stages["align"] - before.stages["align"]).max() > 1e-4
    missing = np.ones_like(valid)
    missing[50] = False  # one to the right and one below: of the same colour
    found = estimate_depth(replace(lf, valid=missing), **options).stages
    np.testing.assert_array_equal(found["sweep"], before.stages["sweep"])  # not in the reference's row or column
    assert np.abs(found["resweep"] - before.stages["resweep"]).max() > 1e-4
    missing = np.ones_like(valid)
    missing[42] = False  # two to the right
    found = estimate_depth(replace(lf, valid=missing), **options).stages
    assert np.abs(found["sweep"] - before.stages["sweep"]).max() > 1e-4


def test_apertures_lie_around_the_reference() -> None:
    offsets = grid(5, 5)
    found = view_sets(offsets, 90)
    assert found.shape == (9, 25)
    assert found[0].all()
    upper_left = (offsets <= 0).all(1)
    rightmost = offsets[:, 0] >= np.abs(offsets[:, 1])
    for quarter in (upper_left, rightmost):
        assert (found == quarter).all(1).sum() == 1
    assert (found[1:, 12] == 1).all()
    found = view_sets(offsets, 180)
    assert found.shape == (9, 25)
    assert found[0].all()
    for half in found[1:]:
        inside = offsets[half > 0]
        assert 12 < len(inside) < 25
        away = inside.mean(0)
        assert (inside @ away >= -1e-9).all()  # all on one side of a line through the reference
        opposite = (offsets @ away < -1e-9) | (np.abs(offsets @ away) < 1e-9)
        assert opposite[half == 0].all()
    found = view_sets(grid(1, 5), 90)
    np.testing.assert_array_equal(found, [[1, 1, 1, 1, 1], [0, 0, 1, 1, 1], [1, 1, 1, 0, 0]])
    assert view_sets(np.array([[0.0, 0], [1, 0], [2, 0]]), 90).shape == (1, 3)


@pytest.mark.parametrize(("pattern", "count"), [("full", 25), ("star", 17), ("cross", 9)])
def test_the_views_of_a_pattern_are_used(pattern: str, count: int) -> None:
    lf = scene("planes", size=32)
    used = used_views(lf.offsets, pattern)
    assert len(used) == count
    assert lf.reference_index in used
    few = scene("planes", views=3, size=32).subset([0, 2, 4, 6, 8])
    assert used_views(few.offsets, pattern) == [0, 1, 2, 3, 4]  # all, where a pattern leaves too few


@pytest.mark.parametrize("preset", ["accurate", "fast"])
@pytest.mark.parametrize(("name", "most"), [("boxes", 10), ("planes", 10), ("relief", 2)])
def test_the_map_is_near_the_truth_and_nearer_after_the_alignment(name: str, most: float, preset: PresetName) -> None:
    found = scores(name, preset)
    assert found["align"].badpix_07 < most
    assert found["align"].badpix_01 < 0.9 * found["sweep"].badpix_01


def test_occlusions_are_where_it_is_better_than_the_synthesis() -> None:
    truth = scene("boxes", size=128).truth.disparity
    matching, synthesis = (evaluate(estimated("boxes", name).disparity, truth) for name in ("accurate", "paper"))
    assert matching.mse_100 < 0.7 * synthesis.mse_100
    assert matching.badpix_07 < 0.7 * synthesis.badpix_07


@pytest.mark.parametrize("name", ["boxes", "planes", "bars"])
def test_outlines_and_filling_bring_the_map_nearer(name: str) -> None:
    found = scores(name, "accurate")
    assert found["boundaries"].mse_100 < found["align"].mse_100
    assert found["boundaries"].badpix_07 < found["align"].badpix_07


@pytest.mark.parametrize("name", ["fast", "accurate"])
def test_without_further_sweeps_there_is_no_such_stage(name: str) -> None:
    for resweeps, again in ((0, []), (1, ["resweep"])):
        config = PRESETS[name].with_values({"sweep.resweeps": resweeps})
        result = estimate_depth(scene("planes", size=48), disparity_range=RANGE, config=config)
        assert list(result.stages) == ["sweep", *again, "align", "boundaries"]


@pytest.mark.parametrize(
    ("preset", "name", "most"),
    [
        ("accurate", "boxes", 0.1),
        ("fast", "boxes", 0.1),
        ("accurate", "textureless", 0.45),
        ("fast", "textureless", 0.35),
    ],
)
def test_confidence_tells_what_is_wrong(name: str, most: float, preset: PresetName) -> None:
    """The fewer of the most confident pixels are kept, the fewer of them are wrong."""
    lf, result = scene(name, size=128), estimated(name, preset)
    assert ((result.confidence > 0) & (result.confidence <= 1)).all()
    curve = sparsification(result.disparity, result.confidence, lf.truth.disparity)
    assert curve.ause < most
    assert np.diff(curve.bad).max() < 0.6  # per cent: a handful of pixels among the few that are left last


@pytest.mark.thorough
@pytest.mark.parametrize("preset", ["accurate", "fast"])
def test_confidence_is_about_the_share_that_is_right(preset: str) -> None:
    """Over scenes with texture together, in bins of the confidence that hold enough pixels.

    Surfaces without texture are filled, and nothing in the views says whether that is right. There the confidence may
    be too low, but over all scenes it is not too high.
    """
    right, expected = {}, {}
    for name in ("boxes", "planes", "bars", "textureless"):
        inner, found, said = np.s_[15:-15, 15:-15], [], []
        for seed, noise in itertools.product((0, 1, 2), (0.0, 0.01, 0.02)):
            lf = scenes.make(name, seed=seed, grid=(5, 5), size=(192, 192), noise=noise)
            result = estimate_depth(lf, disparity_range=RANGE, config=preset, check_cameras=False)
            found.append((np.abs(result.disparity - lf.truth.disparity) <= 0.07)[inner].ravel())
            said.append(result.confidence[inner].ravel())
        right[name], expected[name] = np.concatenate(found), np.concatenate(said)
    assert np.concatenate([*expected.values()]).mean() - np.concatenate([*right.values()]).mean() < 0.05
    good, confidence = (np.concatenate([of[name] for name in ("boxes", "planes", "bars")]) for of in (right, expected))
    assert abs(good.mean() - confidence.mean()) < 0.05
    for low, high in ((0.0, 0.5), (0.5, 0.9), (0.9, 1.0)):
        there = (confidence > low) & (confidence <= high)
        assert there.sum() > 250
        too_low = good[there].mean() - confidence[there].mean()
        # What is said to be uncertain may be right more often than that; what is said to be sure must be.
        assert -0.2 < too_low < 0.3 if low < 0.9 else abs(too_low) < 0.03


def test_confidence_is_low_where_the_map_differs_from_the_matches() -> None:
    """At edges of depth between pixels that look alike, and little where all agree."""
    lf = scene("bars", size=96)
    result = estimate_depth(lf, disparity_range=RANGE, config="accurate")
    apart = np.abs(result.stages["resweep"] - result.disparity)
    assert result.confidence[apart > 0.5].max() < 0.95
    assert result.confidence[apart < 0.02].mean() > result.confidence[apart > 0.2].mean() + 0.15


def test_noise_is_measured_and_borne() -> None:
    lf = scene("relief")
    noise = np.random.default_rng(5).normal(0, 4, lf.views.shape)
    noisy = LightField(
        views=np.clip(lf.views + noise, 0, 255).astype(np.uint8), positions=lf.positions, reference=lf.reference
    )
    device, config = Device(load("reference"), "cpu"), PRESETS["accurate"]
    assert measured_noise(noisy, RANGE, config, device) > 2 * measured_noise(lf, RANGE, config, device)
    matching, synthesis = (
        evaluate(estimate_depth(noisy, disparity_range=RANGE, config=name).disparity, lf.truth.disparity)
        for name in ("accurate", "paper")
    )
    assert matching.badpix_07 < 0.7 * synthesis.badpix_07


def test_surfaces_without_texture_end_where_the_image_has_edges() -> None:
    errors = {0.03: 0.0, 2.0: 0.0}
    for seed, contrast in itertools.product((1, 2), errors):
        lf = scenes.make("textureless", seed=seed, grid=(5, 5), size=(128, 128))
        config = PRESETS["fast"].with_tuning({"semi_global.contrast": contrast, "sweep.resweeps": 0})
        found = estimate_depth(lf, disparity_range=RANGE, config=config, check_cameras=False)
        assert lf.truth is not None
        errors[contrast] += evaluate(found, lf.truth).mse_100
    assert errors[0.03] < 0.9 * errors[2.0]


def test_grain_is_that_of_the_smooth_part() -> None:
    """A fifth of the picture is smooth, the rest is textured; texture is no noise."""
    rng = np.random.default_rng(0)
    image = np.full((120, 120, 3), 0.5)
    image[24:] += rng.uniform(-0.2, 0.2, (96, 120, 3))
    views = np.tile(image + rng.normal(0, 0.01, image.shape), (3, 3, 1, 1, 1)).astype(np.float32)
    grain = measured_grain(LightField.from_grid(views), Device(load(), "cpu"))
    assert grain == pytest.approx(0.01, rel=0.2)


def test_differences_of_intensity_go_with_the_noise() -> None:
    config = PRESETS["accurate"]
    twice, most = in_units_of(0.008, config), in_units_of(1.0, config)
    assert twice.sweep.noise == pytest.approx(0.008)
    assert twice.semi_global.large_penalty == pytest.approx(math.sqrt(2) * config.semi_global.large_penalty)
    assert twice.tuning.alignment.robust == pytest.approx(2 * config.tuning.alignment.robust)
    assert twice.tuning.prior.sigma_color == pytest.approx(math.sqrt(2) * config.tuning.prior.sigma_color)
    assert twice.tuning.sweep == config.tuning.sweep
    assert most.tuning.alignment.robust == pytest.approx(5 * config.tuning.alignment.robust)


def bright(lf: LightField) -> np.ndarray:
    """Return the views as float32, brought to the upper half of the range."""
    views = lf.views.astype(np.float32) * np.float32(lf.scale)
    return np.clip(views * np.float32(0.9 / np.percentile(views[lf.reference_index], 99)), 0, 1)


@pytest.mark.parametrize("preset", ["fast", "accurate"])
def test_less_light_gives_the_same_map(preset: PresetName) -> None:
    lf = scene("boxes")
    views = bright(lf)
    whole, dim = (
        estimate_depth(LightField(views * np.float32(light), lf.positions), config=preset, check_cameras=False)
        for light in (1.0, 2.0**-4)
    )
    assert dim.disparity_range == pytest.approx(whole.disparity_range, abs=1e-3)
    assert (np.abs(dim.disparity - whole.disparity) > 0.07).mean() < 0.01  # 16 bits hold what is smoothed
    assert np.abs(dim.confidence - whole.confidence).mean() < 0.015


@pytest.mark.parametrize("preset", ["fast", "accurate"])
def test_light_that_is_counted_in_few_steps_is_noise_that_the_confidence_sees(preset: PresetName) -> None:
    """A twentieth of the light leaves 12 of 256 steps."""
    lf = scene("boxes", size=128)
    dim = LightField(np.rint(bright(lf) * 255 / 20).astype(np.uint8), lf.positions)
    result = estimate_depth(dim, config=preset, disparity_range=RANGE, check_cameras=False)
    wrong = np.abs(result.disparity - lf.truth.disparity) > 0.07
    assert wrong.mean() < 0.08
    assert result.confidence.mean() < 1 - wrong.mean() + 0.03
    assert wrong[result.confidence > 0.9].mean() < 0.02


def test_the_exposure_is_that_of_the_scene_and_not_of_its_lamps() -> None:
    rng = np.random.default_rng(0)
    views = rng.uniform(0, 0.2, (2, 60, 80, 3)).astype(np.float32)
    views[:, :2, :10] = 1.0
    positions = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert exposure_of(LightField(views, positions, 0)) == 1 / 4
    masked = LightField(views + np.float32(0.7) * (np.arange(80)[:, None] >= 40), positions, 0)
    assert exposure_of(masked) == 1
    assert exposure_of(replace(masked, valid=np.broadcast_to(np.arange(80) < 40, (2, 60, 80)))) == 1 / 4
    assert exposure_of(LightField(np.zeros_like(views), positions, 0)) == 1


def test_noise_that_is_given_is_not_measured() -> None:
    lf = scene("planes", size=48)
    given = PRESETS["fast"].with_values({"sweep.noise": 0.02})
    measured = estimate_depth(lf, disparity_range=RANGE, config="fast").disparity
    assert np.abs(estimate_depth(lf, disparity_range=RANGE, config=given).disparity - measured).max() > 0


@pytest.mark.parametrize("preset", ["fast", "surest"])
def test_broken_pixels_cost_the_pixels_around_them_little(preset: PresetName) -> None:
    lf = scene("relief")
    valid = np.random.default_rng(0).random(lf.views.shape[:3]) > 0.03
    broken = replace(lf, views=np.where(valid[..., None], lf.views, 255 - lf.views), valid=valid)
    whole, found = (estimate_depth(x, disparity_range=RANGE, config=preset).disparity for x in (lf, broken))
    here = valid[lf.reference_index]
    assert (np.isfinite(found) == here).all()
    errors = [np.abs(map_ - lf.truth.disparity)[here] for map_ in (whole, found)]
    shares = [(error > 0.02).mean() for error in errors]
    assert shares[1] < 1.25 * shares[0]  # 1.4 and 2.2 times if they are left out


def test_masked_pixels_say_nothing() -> None:
    """Values of masked pixels make no difference, and a vignette does not break the map.

    Beside them it makes some: what is interpolated between a pixel and a masked one, and its gradient, hold both.
    """
    lf = scene("relief")
    one_way = masked(lf, np.s_[:, :8, :8], np.s_[:, -8:, -8:], 3)
    other_way = replace(one_way, views=np.where(one_way.valid[..., None], lf.views, 255 - lf.views))
    one, two = (
        estimate_depth(field, disparity_range=RANGE, config="accurate").disparity for field in (one_way, other_way)
    )
    y, x = np.mgrid[: lf.size[0], : lf.size[1]]
    away = np.minimum(np.maximum(y, x) - 7, np.maximum(lf.size[0] - y, lf.size[1] - x) - 8)  # from both corners
    apart = np.abs(one - two)
    assert np.isnan(one).sum() == np.isnan(two).sum() == 2 * 8 * 8
    assert apart[away >= 8].max() < 0.02
    assert apart[away >= 12].max() < 1e-3
    assert apart[away >= 16].max() < 1e-5


def test_penalties_rise_where_there_is_more_noise_than_elsewhere() -> None:
    """Noise in the left half of all views: with the penalties of the right half, that half of the map is worse."""
    lf, rng = scene("planes", size=128), np.random.default_rng(6)
    deviation = np.where(np.arange(128) < 64, 16, 1)[:, None]
    views = np.clip(lf.views + rng.normal(0, 1, lf.views.shape) * deviation, 0, 255).astype(np.uint8)
    noisy = LightField(views, lf.positions, reference=lf.reference_index)

    def squared_error(config: Config) -> float:
        found = estimate_depth(noisy, disparity_range=RANGE, config=config).disparity
        return float(((found - lf.truth.disparity)[15:-15, 15:64] ** 2).mean())

    fast = PRESETS["fast"]
    assert squared_error(fast) < 0.7 * squared_error(fast.with_tuning({"semi_global.most_noisy": 1.0}))


@pytest.mark.parametrize("preset", ["accurate", "fast"])
def test_lengths_are_those_in_the_farthest_view(preset: str) -> None:
    """Positions counted in steps half as long, with disparities half as large, give the same map to the bit.

    What is given as a curvature is the exception: it is counted per view step, so here it is four times as large.
    """
    lf = scenes.make("boxes", grid=(5, 5), size=(40, 48), disparity_range=(-1, 1), noise=0.01, seed=1)
    config = PRESETS[preset].with_tuning({"sweep.noise": 0.004, "alignment.longest_step": 0.05})  # which some reach
    found = estimate_depth(lf, config=config, disparity_range=(-1.2, 1.2), device="cpu")

    halved = replace(lf, positions=2 * lf.positions, truth=None, grid_shape=None)
    curvatures = ("alignment.stiffness", "alignment.least_curvature", "hole_filling.stiffness")
    config = config.with_tuning({name: 4 * value_of(config.tuning, name) for name in curvatures})
    again = estimate_depth(halved, config=config, disparity_range=(-0.6, 0.6), device="cpu")
    for stage, values in found.stages.items():
        assert np.array_equal(2 * again.stages[stage], values), stage
    assert method_of(config).same_surface(halved.layout) == method_of(config).same_surface(lf.layout) / 2


def value_of(config: Config, name: str) -> float:
    section, parameter = name.split(".")
    return float(getattr(getattr(config, section), parameter))
