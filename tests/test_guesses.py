"""Guessed surfaces hide no more than the farther ones of them."""

import numpy as np
import pytest

from lfgpu import LightField, estimate_depth, scenes
from lfgpu._backends import load
from lfgpu.contract import Device, Disparities
from lfgpu.methods import preset
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.guesses import GuessedSurfaces

COUNT, STEP, SIDE = 41, 0.1, 48
FAR, NEAR = -2.0, 2.0


def hiding(surface: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """What of a map hides anything, if its costs [l, y, x] and their paths say the same."""
    kernels = load("warp")
    ones = kernels.field(np.ones(surface.shape), "cpu")
    disparities = Disparities(FAR, STEP, COUNT)
    guesses = GuessedSurfaces(
        Arena(Device(kernels, "cpu")), surface.shape, share=0.3, disparities=disparities, tolerance=0.3, ones=ones
    )
    out, volume = kernels.zeros(surface.shape, "cpu"), kernels.field(costs.astype(np.float32), "cpu")
    evidence, *unused = (kernels.zeros(surface.shape, "cpu") for _ in range(3))
    outputs = {"evidence_out": evidence, "conflict_out": unused[0], "cost_out": unused[1]}
    kernels.evidence(volume, volume, step=STEP, unit=0.01, **outputs)
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
        costs[round((surface[y, x] - FAR) / STEP), y, x] = 0.0
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


def test_a_wall_of_noise_comes_less_near_in_further_sweeps(rng: np.random.Generator) -> None:
    lf = square_before_a_wall(0.03, rng)

    def near(ambiguity: float) -> float:
        config = preset("accurate").with_tuning({"sweep.ambiguity": ambiguity})
        result = estimate_depth(lf, disparity_range=(-3, 3), config=config, check_cameras=False)
        return float((result.stages["resweep"] > 1).mean())

    assert near(preset("accurate").tuning.sweep.ambiguity) < near(1.0) - 0.05


def test_every_difference_may_be_a_depth_edge() -> None:
    """A tolerance of 0 is in its range."""
    lf = scenes.make("boxes", grid=(5, 5), size=(48, 48))
    config = preset("accurate").with_tuning({"sweep.tolerance": 0.0})
    result = estimate_depth(lf, disparity_range=(-2, 2), config=config, check_cameras=False)
    assert np.isfinite(result.disparity).all()
