"""Parts of matching: alignment, outlines, guessed surfaces, ranges wider than the scene, numbers with their reasons."""

import json
from collections.abc import Iterator
from dataclasses import Field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.ablation import VARIANTS
from lfgpu import LightField, estimate_depth, scenes
from lfgpu._backends import load
from lfgpu.config import as_dict, restored
from lfgpu.contract import Device, Disparities
from lfgpu.methods import METHODS, PRESETS, preset
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching import tuning
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.guesses import GuessedSurfaces
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.measured import Measured
from lfgpu.metrics import evaluate

STEP = MatchingConfig().sweep.step / 2  # pixels per view step between disparities, in a grid of 5 x 5 views


def test_what_the_alignment_moved_too_far_is_put_back() -> None:
    """With a reach of 0.4 px: pixels that moved less stay where they are, all others return."""
    lf, kernels = scenes.make("boxes", grid=(5, 5), size=(48, 48)), load("warp")
    config = MatchingConfig().with_tuning({"alignment.reach": 0.4 / STEP})
    matching = MatchingPlan(lf.layout, Measured((-1.0, 1.0), 0.004, None), config, Device(kernels, "cpu"))
    moved = np.linspace(-0.8, 0.8, 48 * 48, dtype=np.float32).reshape(48, 48)
    map_ = kernels.field(0.1 + moved, "cpu")
    matching._alignment.put_back(kernels.field(np.full((48, 48), 0.1), "cpu"), map_)
    want = np.where(np.abs(moved) < 0.4, 0.1 + moved, 0.1)
    np.testing.assert_allclose(kernels.numpy(map_), want, atol=1e-6)


def test_what_the_alignment_moved_is_drawn_back_by_what_the_matched_map_states() -> None:
    """With a deviation of 0.1 px: small moves stay, one of 0.1 px is halved, large ones return nearly whole."""
    lf, kernels = scenes.make("boxes", grid=(5, 5), size=(48, 48)), load("warp")
    matching = MatchingPlan(lf.layout, Measured((-1.0, 1.0), 0.004, None), preset("learned"), Device(kernels, "cpu"))
    moved = np.linspace(-0.8, 0.8, 48 * 48, dtype=np.float32).reshape(48, 48)
    moved[0, :3] = 0.001, 0.1, -0.8
    map_, matched, variance = (kernels.field(np.broadcast_to(x, (48, 48)), "cpu") for x in (0.1 + moved, 0.1, 0.01))
    matching._alignment._weigh_matched(variance)
    matching._alignment._draw_back(matched, map_)
    found = kernels.numpy(map_) - 0.1
    np.testing.assert_allclose(found, moved / (1 + (moved / 0.1) ** 2), atol=1e-6)
    np.testing.assert_allclose(found[0, :3], (0.001, 0.05, -0.8 / 65), atol=1e-6)


def test_a_turned_surface_has_no_depth_edges() -> None:
    """The floor and the sides of boxes change by more than a pixel in the farthest view from one pixel to the next."""
    lf = scenes.make("boxes", seed=3, grid=(9, 9), size=(96, 96), disparity_range=(-8.0, 8.0))
    result = estimate_depth(lf, disparity_range=(-8.0, 8.0), config="accurate", device="cpu", check_cameras=False)
    aligned, finished = (
        evaluate(map_, lf.reference_truth().disparity).badpix_07 for map_ in (result.stages["align"], result.disparity)
    )
    assert finished < 1.3 * aligned


def test_where_a_depth_edge_begins_depends_on_the_range_only_if_that_is_wide() -> None:
    """A plan goes on with another narrow range, and not with another wide one."""
    lf = scenes.make("boxes", grid=(5, 5), size=(48, 48))
    device = Device(load("warp"), "cpu")
    for bounds, others, goes_on in (((-1.0, 1.0), (-1.01, 0.99), True), ((-15.0, 15.0), (-15.01, 15.0), False)):
        plan = MatchingPlan(lf.layout, Measured(bounds, 0.004, None), MatchingConfig(), device)
        assert plan.follow(Measured(others, 0.004, None)) == goes_on


COUNT, STEEP, SIDE = 41, 0.1, 48
FAR, NEAR = -2.0, 2.0


def hiding(surface: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """What of a map hides anything, if its costs [l, y, x] and their paths say the same."""
    kernels = load("warp")
    ones = kernels.field(np.ones(surface.shape), "cpu")
    disparities = Disparities(FAR, STEEP, COUNT)
    guesses = GuessedSurfaces(
        Arena(Device(kernels, "cpu")),
        surface.shape,
        share=0.3,
        disparities=lambda: disparities,
        tolerance=0.3,
        ones=ones,
    )
    out, volume = kernels.zeros(surface.shape, "cpu"), kernels.field(costs.astype(np.float32), "cpu")
    evidence, *unused = (kernels.zeros(surface.shape, "cpu") for _ in range(3))
    outputs = {"evidence_out": evidence, "conflict_out": unused[0], "cost_out": unused[1]}
    kernels.evidence(volume, volume, step=STEEP, unit=0.01, **outputs)
    guesses.run(evidence, kernels.field(surface.astype(np.float32), "cpu"), out)
    return kernels.numpy(out)


def alike() -> np.ndarray:
    """Costs that say nothing."""
    return np.full((COUNT, SIDE, SIDE), 0.02)


def at_random(rng: np.random.Generator) -> np.ndarray:
    return np.where(rng.uniform(size=(SIDE, SIDE)) < 0.5, NEAR, FAR)


def test_of_a_map_at_random_the_farther_half_is_left(rng: np.random.Generator) -> None:
    surface = at_random(rng)
    out = hiding(surface, alike())
    assert out.max() < FAR + 0.1 * (NEAR - FAR)
    np.testing.assert_array_equal(out[surface == FAR], np.float32(FAR))


def test_what_costs_tell_apart_hides_as_it_is(rng: np.random.Generator) -> None:
    surface, costs = at_random(rng), alike() + 1.0
    for y, x in np.ndindex(surface.shape):
        costs[round((surface[y, x] - FAR) / STEEP), y, x] = 0.0
    np.testing.assert_array_equal(hiding(surface, costs), surface.astype(np.float32))


@pytest.mark.parametrize("shape", ["plane", "outline", "slanted outline", "corner"])
def test_an_even_map_hides_as_it_is(shape: str) -> None:
    """Even if costs say nothing: things without texture hide what is behind them, too."""
    y, x = np.mgrid[:SIDE, :SIDE]
    nearer = {"outline": x > 20, "slanted outline": x + 2 * y > 60, "corner": (x > 20) & (y > 30)}
    surface = 0.01 * x if shape == "plane" else np.where(nearer[shape], NEAR, FAR)
    np.testing.assert_array_equal(hiding(surface, alike()), surface.astype(np.float32))


def square_before_a_wall(noise: float, rng: np.random.Generator) -> LightField:
    """The wall shows nothing but noise; the square has texture, and is 4 pixels per view step nearer."""
    side, texture = 160, rng.uniform(0.3, 1.0, (160, 160))
    y, x = np.mgrid[:side, :side]
    views, positions = [], [(u, v) for v in range(-4, 5) for u in range(-4, 5)]
    for u, v in positions:
        column, row = x + round(NEAR) * u, y + round(NEAR) * v
        inside = (np.abs(column - side // 2) < 30) & (np.abs(row - side // 2) < 30)
        seen = np.where(inside, texture[row % side, column % side], 0.15)
        views.append(np.clip(seen + noise * rng.standard_normal(seen.shape), 0, 1))
    return LightField(np.asarray(views, np.float32), np.asarray(positions, np.float64))


@pytest.mark.thorough
def test_a_wall_of_noise_comes_less_near_in_further_sweeps(rng: np.random.Generator) -> None:
    walls = [square_before_a_wall(0.03, rng) for _ in range(4)]  # noise of one alone may do the opposite

    def near(ambiguity: float) -> float:
        config = preset("accurate").with_tuning({"sweep.ambiguity": ambiguity})
        results = [estimate_depth(lf, disparity_range=(-3, 3), config=config, check_cameras=False) for lf in walls]
        return float(np.mean([result.stages["resweep"] > 1 for result in results]))

    assert near(preset("accurate").tuning.sweep.ambiguity) < near(1.0) - 0.05


def test_every_difference_may_be_a_depth_edge() -> None:
    """A tolerance of 0 is in its range."""
    lf = scenes.make("boxes", grid=(5, 5), size=(48, 48))
    config = preset("accurate").with_tuning({"sweep.tolerance": 0.0})
    result = estimate_depth(lf, disparity_range=(-2, 2), config=config, check_cameras=False)
    assert np.isfinite(result.disparity).all()


@pytest.mark.parametrize("config", ["fast", "accurate"])
@pytest.mark.parametrize("name", ["boxes", "textureless"])
def test_a_range_that_is_wider_than_the_scene_changes_next_to_nothing(config: str, name: str) -> None:
    lf = scenes.make(name, grid=(5, 5), size=(96, 96))
    low, high = lf.truth.disparity.min() - 0.1, lf.truth.disparity.max() + 0.1
    narrow, wide = (
        estimate_depth(
            lf, disparity_range=(low - more, high + more), config=config, device="cpu", check_cameras=False
        ).disparity
        for more in (0.0, 0.07)
    )
    assert (np.abs(wide - narrow) > 0.02).mean() < 0.002


ABLATION = Path(__file__).parents[1] / "benchmarks" / "results" / "ablation.json"


def numbers() -> Iterator[tuple[str, Field[Any]]]:
    for section in fields(tuning.MatchingTuning):
        if is_dataclass(section.default):
            yield from ((f"{section.name}.{number.name}", number) for number in fields(section.default))


def test_every_number_says_why_and_names_a_row_that_there_is() -> None:
    measured = {record["name"] for record in json.loads(ABLATION.read_text())["records"]}
    for name, number in numbers():
        meta = number.metadata
        assert len(meta["reason"].split()) >= 6, name
        assert meta["reason"].endswith("."), name
        assert isinstance(meta["unit"], str), name
        if meta["ablation"]:
            (variant,) = (variant for variant in VARIANTS if variant.name == meta["ablation"])
            assert variant.name in measured
            assert name in variant.values, "the variant changes this number"


def test_a_changed_number_is_for_experiments_only() -> None:
    """Files name the tuning, and hold none of its numbers."""
    changed = PRESETS["fast"].with_tuning({"alignment.robust": 0.02, "sweep.step": 0.3})  # type: ignore[attr-defined]
    assert isinstance(changed, MatchingConfig)
    assert (changed.tuning.name, changed.tuning.alignment.robust, changed.sweep.step) == ("", 0.02, 0.3)
    kept = restored(as_dict(changed), METHODS["matching"].presets)
    assert kept == PRESETS["fast"].with_values({"sweep.step": 0.3})
    assert as_dict(PRESETS["fast"])["tuning"] == "fast"
