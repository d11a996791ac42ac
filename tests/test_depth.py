"""The method of the paper on small scenes with exact truth, and what its result says about itself."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu.data import DepthResult, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read
from lfgpu.methods import preset
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.method import Synthesis
from lfgpu.metrics import Metrics, evaluate
from lfgpu.pipelines import estimate as depth, rehearsal
from tests.made import masked, thorough

RANGE = (-1.5, 1.5)
CONVERGED = SynthesisConfig().with_values({"refinement.tolerance": 1e-6, "refinement.max_iterations": 500})
"""Where two minimisations are compared, so that not the iteration at which each happened to stop is."""
STAGES = tuple(stage.name for stage in Synthesis.STAGES)
QUICK = SynthesisConfig().with_values({"refinement.max_iterations": 3, "prior.window": 5})


def estimate_depth(lf: LightField, **options: Any) -> DepthResult:
    """By the paper's method, if not asked otherwise."""
    return depth.estimate_depth(lf, **({"config": "paper"} | options))


@cache
def relief(**options: Any) -> LightField:
    return scenes.make("relief", **({"grid": (7, 7), "size": (96, 96)} | options))


@cache
def small(**options: Any) -> LightField:
    return relief(**({"grid": (5, 5), "size": (56, 64)} | options))


def tiny(**options: Any) -> LightField:
    return relief(**({"grid": (3, 3), "size": (40, 48)} | options))


@cache
def estimated(**options: Any) -> DepthResult:
    """Relief, within the range that the scene was made for."""
    return estimate_depth(relief(**options), disparity_range=options.get("disparity_range", RANGE))


@cache
def quick() -> DepthResult:
    return estimate_depth(small(), disparity_range=RANGE, config=QUICK, device="cpu")


@cache
def converged(solver: str) -> DepthResult:
    config = CONVERGED.with_values({"refinement.solver": solver})
    return estimate_depth(tiny(), config=config, disparity_range=RANGE, device="cpu")


def scores(lf: LightField, result: DepthResult) -> dict[str, Metrics]:
    truth = lf.reference_truth()
    return {stage: evaluate(values, truth.disparity) for stage, values in result.stages.items()}


def difference(one: np.ndarray, other: np.ndarray, share: float = 0.95) -> float:
    """Return the bound that a share of the differences keeps, pixels per view step."""
    return float(np.quantile(np.abs(one - other), share))


# --- accuracy ---


def test_each_stage_is_better_than_the_one_before_and_the_last_within_two_hundredths_of_a_pixel() -> None:
    lf = scenes.make("relief", grid=(9, 9), size=(128, 128))
    rmse = {stage: score.rmse for stage, score in scores(lf, estimate_depth(lf)).items()}
    assert rmse["refine"] < rmse["propagate"] < rmse["local"]
    assert rmse["refine"] < 0.015


@pytest.mark.parametrize(("name", "noise"), [("textureless", 0.0), ("relief", 0.02)], ids=["textureless", "noisy"])
def test_propagated_map_fills_and_is_better_than_the_local_one(name: str, noise: float) -> None:
    """Although only what was defined counts in the local map's error."""
    lf = scenes.make(name, grid=(5, 5), size=(96, 96), noise=noise)
    found = scores(lf, estimate_depth(lf, disparity_range=RANGE, config=QUICK))
    assert found["local"].undefined > 2
    assert found["propagate"].undefined == 0
    assert found["propagate"].rmse < found["local"].rmse


@pytest.mark.data("cotton")
def test_a_piece_of_a_real_benchmark_is_found(data_folder: Path) -> None:
    lf = read(data_folder).crop(slice(200, 320), slice(200, 320)).subset("star")
    result = estimate_depth(lf)
    found = scores(lf, result)
    assert found["refine"].badpix_07 < 5
    assert found["refine"].rmse < 0.05
    truth = lf.truth.disparity  # type: ignore[union-attr]
    assert result.disparity_range[0] <= np.quantile(truth, 0.01) < np.quantile(truth, 0.99) <= result.disparity_range[1]


def test_any_view_may_be_the_reference() -> None:
    place = (3, 6)
    lf = relief(reference=place)
    result = estimated(reference=place)
    assert scores(lf, result)["refine"].rmse < 0.035
    assert result.position == (place[1], place[0])


@pytest.mark.parametrize("pattern", [thorough("star"), "column"])
def test_some_of_the_views_are_enough(pattern: str) -> None:
    lf = relief().subset(pattern)
    assert scores(lf, estimate_depth(lf, disparity_range=RANGE))["refine"].rmse < 0.035


# --- the same scene in other clothes ---


def test_other_kinds_of_values_give_the_same_map() -> None:
    grey = tiny(channels=1)
    colour = LightField(np.repeat(grey.views, 3, axis=3), grey.positions, reference=grey.reference)
    one, other = (estimate_depth(lf, config=QUICK, disparity_range=RANGE).disparity for lf in (grey, colour))
    assert difference(one, other, 0.5) < 1e-3  # 95 % of them are below 0.011 only
    fine, stored, coarse = (
        estimate_depth(tiny(dtype=dtype), config=QUICK, disparity_range=RANGE).disparity
        for dtype in ("float32", "uint16", "uint8")
    )
    assert difference(fine, stored) < 1e-3
    assert difference(fine, coarse, 0.5) < 0.02


@cache
def upright() -> DepthResult:
    return estimate_depth(small(), disparity_range=RANGE, device="cpu")


def transposed(lf: LightField) -> LightField:
    return LightField(np.ascontiguousarray(lf.views.swapaxes(1, 2)), lf.positions[:, ::-1], reference=lf.reference)


def mirrored(lf: LightField) -> LightField:
    return LightField(lf.views[:, :, ::-1].copy(), lf.positions * (-1, 1), reference=lf.reference)


@pytest.mark.parametrize(("turn", "back"), [(transposed, np.transpose), thorough(mirrored, np.fliplr)])
def test_a_turned_scene_gives_the_turned_map(turn: Any, back: Any) -> None:
    one, other = upright(), estimate_depth(turn(small()), disparity_range=RANGE)
    assert difference(one.stages["propagate"], back(other.stages["propagate"])) < 1e-3
    assert difference(one.disparity, back(other.disparity)) < 5e-3
    assert difference(one.confidence, back(other.confidence)) < 1e-3


def test_views_masked_out_are_views_left_out() -> None:
    """Off the reference's row and column, so that the local estimate has nothing to do with them."""
    lf = small()
    lost = [0, 4, 8, 20]
    views = lf.views.copy()
    views[lost] = 255 - views[lost]
    broken = replace(masked(lf, lost), views=views)
    left = lf.subset([index for index in range(25) if index not in lost])
    one, other = (estimate_depth(field, disparity_range=RANGE) for field in (broken, left))
    # The energies differ by the number of views that they are averaged over, the minima by what that changes.
    assert difference(one.disparity, other.disparity) < 5e-3


def test_masked_pixels_do_not_count() -> None:
    lf = small()
    known = masked(lf, np.s_[[0, 4, 20, 24], :20, :20])
    garbage = replace(known, views=np.where(known.valid[..., None], lf.views, 255).astype(np.uint8))
    one, other = (estimate_depth(field, config=QUICK, disparity_range=RANGE) for field in (known, garbage))
    assert difference(one.disparity, other.disparity) < 1e-3
    assert np.abs(one.disparity - other.disparity).max() < 0.05


# --- the result ---


def test_results_are_float32_maps_within_the_range() -> None:
    result = estimate_depth(small(), disparity_range=(-0.5, 0.75))
    assert result.disparity_range == (-0.5, 0.75)
    for stage in ("local", "propagate", "refine"):
        assert np.float32(-0.5) <= np.nanmin(result.stages[stage])
        assert np.nanmax(result.stages[stage]) <= np.float32(0.75)
    result = quick()
    lines = ["local_row", "coherence_row", "local_column", "coherence_column"]
    assert list(result.stages) == [*lines, "local", "propagate", "refine"]
    for values in (result.disparity, result.confidence, result.depth, *result.stages.values()):
        assert (values.shape, values.dtype) == ((56, 64), np.float32)
    np.testing.assert_array_equal(result.disparity, result.stages["refine"])


def test_confidence_lies_between_0_and_1_and_is_low_where_there_is_nothing_to_see() -> None:
    lf = small()
    views = lf.views.copy()
    views[:, :, 32:] = 120  # the right half is blank in every view
    blank = estimate_depth(LightField(views, lf.positions, reference=lf.reference), disparity_range=RANGE, config=QUICK)
    assert blank.confidence.min() >= 0
    assert blank.confidence.max() <= 1 + 1e-6
    assert np.median(blank.confidence[:, 48:]) < 0.1
    assert np.median(blank.confidence[:, :24]) > 0.7


def test_depth_is_that_of_the_geometry() -> None:
    lf = small()
    result = quick()
    assert result.depth is not None
    np.testing.assert_allclose(result.depth, lf.geometry.depth(result.disparity), rtol=1e-6)
    without = LightField(lf.views, lf.positions, reference=lf.reference)
    assert estimate_depth(without, disparity_range=RANGE, config=QUICK).depth is None


def test_result_says_how_it_came_about() -> None:
    result = quick()
    assert set(result.timings) == {"compile", "measure", *STAGES, "total"}
    assert 0 < max(result.timings[stage] for stage in STAGES) <= result.timings["total"]
    assert sum(result.timings[stage] for stage in STAGES) <= result.timings["total"]
    assert result.versions.keys() >= {"lfgpu", "numpy", "scipy", "warp-lang"}
    assert all(version[0].isdigit() for version in result.versions.values())
    assert result.status.startswith("Propagation: ")
    assert " Refinement: " in result.status
    assert result.status.endswith(".")
    assert (result.backend, result.device, result.name, result.config) == ("warp", "cpu", "relief", QUICK)


def test_solvers_of_the_refinement_find_the_same_map() -> None:
    one, other = (converged(solver) for solver in ("lbfgs", "lbfgsb"))
    assert difference(one.disparity, other.disparity) < 1e-3
    assert one.trace[-1] == pytest.approx(other.trace[-1], rel=5e-3)
    found, want = (scores(tiny(), result)["refine"] for result in (one, other))
    assert found.rmse == pytest.approx(want.rmse, rel=0.02)


def test_energy_falls_and_convergence_is_said() -> None:
    whole, cut = estimated(), quick()
    assert (np.diff(whole.trace) <= 0).all()
    assert whole.converged
    assert not cut.converged
    assert len(cut.trace) == 4
    assert "limit of iterations" in cut.status


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "near"), [("paper", 3e-3), ("paper-exact", 1e-3)])
@pytest.mark.parametrize("scene", ["boxes", "relief"])
def test_a_map_that_converged_is_near_its_minimum(name: str, near: float, scene: str) -> None:
    """As docs/devices.md says; 95 % of the pixels of each stage."""
    lf = scenes.make(scene, grid=(5, 5), size=(56, 64))
    further = {
        "propagation.solver": "cg",
        "propagation.tolerance": 1e-7,
        "refinement.tolerance": 1e-9,
        "refinement.max_iterations": 1000,
    }
    lowest = preset(name).with_values(further)
    found, minimum = (estimate_depth(lf, config=c, disparity_range=RANGE, device="cpu") for c in (name, lowest))
    assert found.converged
    for stage in ("propagate", "refine"):
        assert difference(found.stages[stage], minimum.stages[stage]) < near, stage


@pytest.mark.parametrize("name", ["fast", "accurate"])
def test_matching_converges_where_there_is_a_surface(name: str) -> None:
    result = estimate_depth(scenes.make("bars", grid=(7, 7), size=(64, 64)), config=name, device="cpu")
    assert result.converged, result.status


def test_a_step_that_leaves_the_matched_surface_is_no_convergence(rng: np.random.Generator) -> None:
    """In noise it is 0.114 px, with a standard deviation of 0.003 px, and halfway to the next disparity is 0.05 px."""
    noise = LightField.from_grid(rng.random((5, 5, 64, 72, 3), np.float32))
    config = preset("fast").with_values({"sweep.step": 0.2})
    result = estimate_depth(noise, config=config, disparity_range=RANGE, device="cpu")
    assert not result.converged, result.status


def test_no_iterations_of_refinement_leave_the_propagated_map() -> None:
    config = SynthesisConfig().with_values({"refinement.max_iterations": 0})
    result = estimate_depth(small(), disparity_range=RANGE, config=config)
    np.testing.assert_allclose(result.disparity, result.stages["propagate"].clip(*RANGE), rtol=0, atol=1e-6)


def test_progress_is_reported_stage_by_stage() -> None:
    calls: list[tuple[str, int, float]] = []
    result = estimate_depth(
        small(), disparity_range=RANGE, config=QUICK, on_progress=lambda *call: calls.append(call)
    )  # fmt: skip
    assert tuple(dict.fromkeys(stage for stage, _, _ in calls)) == STAGES
    for stage in STAGES:
        iterations = [iteration for name, iteration, _ in calls if name == stage]
        assert iterations == list(range(len(iterations)))
        assert len(iterations) > 1 or stage == "local"
    assert [value for stage, iteration, value in calls if stage == "refine" and iteration] == list(result.trace[1:])


def test_views_are_left_as_they_were() -> None:
    before = small().views.copy()
    quick.__wrapped__()
    np.testing.assert_array_equal(small().views, before)


# --- errors ---


def test_wrong_ranges_are_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for wrong in ((1.0, 1.0), (2.0, -2.0), (float("nan"), 1.0), (0.0, float("inf")), (1.0,), 3):
        monkeypatch.setattr(rehearsal, "_known", set())  # nothing has run yet
        with pytest.raises(LightFieldError, match="disparity range must be two finite numbers, low < high"):
            estimate_depth(small(), config="fast", disparity_range=wrong)  # type: ignore[arg-type]
    for beyond in ((-1e9, 1e9), (50.0, 70.0)):
        with pytest.raises(LightFieldError, match="it shifts even the nearest view by"):
            estimate_depth(small(), disparity_range=beyond)


def test_a_reference_alone_in_its_row_and_column_is_refused() -> None:
    lf = small()
    diagonal = lf.subset([lf.index_of(k, k) for k in range(5)])
    with pytest.raises(LightFieldError, match="needs a second view in the row or the column"):
        estimate_depth(diagonal, disparity_range=RANGE)
    with pytest.raises(LightFieldError, match="needs a second view in the row or the column"):
        estimate_depth(diagonal)


def test_views_without_any_texture_are_refused() -> None:
    flat = LightField.from_grid(np.full((3, 3, 40, 40, 3), 128, np.uint8))
    for config, bounds, words in (
        ("paper", None, "disparity range cannot be found"),
        ("paper", RANGE, "coherent"),
        ("accurate", RANGE, "no pixel shows anything"),
    ):
        with pytest.raises(LightFieldError, match=words):
            estimate_depth(flat, config=config, disparity_range=bounds)


def test_a_config_of_another_kind_is_refused() -> None:
    with pytest.raises(LightFieldError, match=r"config must be the name of a preset .* or a Config, not dict"):
        estimate_depth(small(), config={"prior.window": 5})  # type: ignore[arg-type]


def test_what_is_masked_in_the_reference_is_not_known_and_leaves_what_is_around_it() -> None:
    lf = relief()
    hole, views = np.s_[40:56, 40:56], lf.views.copy()
    views[lf.reference_index][hole] = np.random.default_rng(0).integers(0, 256, (16, 16, 3))
    known = masked(replace(lf, views=views), (lf.reference_index, *hole))
    error = np.abs(estimate_depth(known).disparity - lf.truth.disparity)  # type: ignore[union-attr]
    assert np.isnan(error[hole]).all()
    assert np.sqrt(np.nanmean(error[15:-15, 15:-15] ** 2)) < 0.1
