"""The preset 'paper-exact' against the printed equations, on every backend; and what 'paper' changes in them."""

import itertools
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu.contract import Device
from lfgpu.methods import method_of, preset
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.energy import Energy
from lfgpu.methods.synthesis.model import ForwardModel
from lfgpu.methods.synthesis.plan import SynthesisPlan, in_units_of, noise_in_units, planned_prior, spread
from tests import printed
from tests.made import masked, thorough

RANGE = (-1.5, 1.6)


def test_the_kernels_compute_the_printed_equations(target: Any) -> None:
    tolerance = 1e-6 if target.kernels.dtype is np.float64 else 2e-5
    found = printed.errors(target.kernels, target.device)
    assert {name: error for name, error in found.items() if not error <= tolerance} == {}
    assert len(found) == 10


def test_the_spread_counts_no_masked_pixels() -> None:
    lf = printed.small_light_field()
    image = lf.image(lf.reference_index).astype(np.float64)
    found = spread(masked(lf, np.s_[lf.reference_index, :, 5:]), 3)
    assert np.square(found) == pytest.approx(printed.variances(image[:, :5], 3))
    nothing = spread(masked(lf, np.s_[:]), 3)
    assert nothing == (1e-6, 1e-6)


# --- the energy of `paper`: λ, the mean, what the prior holds together ---


def value(
    lf: lfgpu.LightField, config: SynthesisConfig, disparity: np.ndarray, start: np.ndarray, target: Any
) -> float:
    kernels, device = target.kernels, Device(target.kernels, target.device)
    prior = planned_prior((*lf.size, lf.channels), config.prior, device)
    prior.load(kernels.image(lf.image(lf.reference_index), target.device))
    model = ForwardModel(lf.layout, config.refinement, device)
    model.load(kernels.image(lf.views, target.device), kernels.field(start, target.device))
    smoothed = kernels.field(start, target.device) if config.refinement.smooths == "change" else None
    energy = Energy(model, prior, config.refinement.smoothness, smoothed)
    gradient, found = kernels.zeros(lf.size, target.device), kernels.scalar(0.0, target.device)
    energy(kernels.field(disparity, target.device), gradient, found)
    return float(kernels.number(found))


@pytest.mark.parametrize("smooths", ["map", "change"])
@pytest.mark.parametrize("error", ["mean", "sum"])
def test_the_prior_counts_lambda_times_and_the_error_as_it_says(smooths: str, error: str, target: Any) -> None:
    lf, rng = printed.small_light_field(), np.random.default_rng(2)
    start, disparity = (rng.uniform(-0.8, 0.8, lf.size) for _ in range(2))
    image = lf.image(lf.reference_index).astype(np.float64)
    changed = {"refinement.smooths": smooths, "refinement.error": error, "refinement.smoothness": 0.37}
    config = in_units_of(
        method_of("paper-exact").measure(lf, Device(target.kernels, target.device), disparity_range=(-1, 1)),
        printed.exact_config().with_values(changed),
    )
    w = printed.weights(image, printed.WINDOW, 3, *printed.variances(image, 3))
    prior = 0.37 * printed.prior(disparity - start if smooths == "change" else disparity, w)
    views = np.stack([lf.image(n) for n in range(9)]).astype(np.float64)
    squares = printed.energy(views, lf.offsets, image, disparity, w, 0.0)
    want = squares * (1 / (8 * 3) if error == "mean" else 1) + prior
    assert prior > 0.02 * want
    assert value(lf, config, disparity, start, target) == pytest.approx(want, rel=1e-5)


# --- the maps of figure 1 ---


def test_the_local_estimate_is_the_more_coherent_of_row_and_column() -> None:
    lf = scenes.make("boxes", grid=(5, 5), size=(48, 56))
    config = preset("paper").with_values({"refinement.max_iterations": 1})
    maps = lfgpu.estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu").stages
    by_row = maps["coherence_row"] >= maps["coherence_column"]
    coherence = np.maximum(maps["coherence_row"], maps["coherence_column"])
    want = np.where(by_row, maps["local_row"], maps["local_column"])
    trusted = coherence >= config.local.coherence_threshold  # type: ignore[attr-defined]
    np.testing.assert_array_equal(maps["local"], np.where(trusted, want, np.nan))
    assert 0.2 < by_row.mean() < 0.8


@pytest.mark.parametrize(("line", "other"), [("row", "column"), ("column", "row")])
def test_a_line_of_views_has_the_maps_of_that_line_only(line: str, other: str) -> None:
    lf = scenes.make("relief", grid=(5, 5), size=(32, 40)).subset(line)
    config = preset("paper").with_values({"refinement.max_iterations": 1})
    maps = lfgpu.estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu").stages
    assert f"coherence_{line}" in maps
    assert f"coherence_{other}" not in maps


# --- by-pixel acceptance ---


QUICK = (("bars", 0.02),)
OTHERS = [case for case in itertools.product(scenes.NAMES, (0.0, 0.02)) if case not in QUICK]


@pytest.mark.parametrize(("name", "noise"), [*QUICK, *(thorough(*case) for case in OTHERS)])
def test_the_refinement_leaves_no_map_worse(name: str, noise: float) -> None:
    lf = scenes.make(name, grid=(7, 7), size=(112, 112), noise=noise)
    maps = lfgpu.estimate_depth(lf, config="paper", disparity_range=RANGE, device="cpu").stages
    before, after = (lfgpu.evaluate(maps[stage], lf.truth.disparity) for stage in ("propagate", "refine"))
    assert after.badpix_07 <= before.badpix_07
    assert after.badpix_01 <= before.badpix_01
    assert after.mse_100 <= before.mse_100


def test_without_acceptance_it_does() -> None:
    """So that the test above is one."""
    lf = scenes.make("boxes", grid=(7, 7), size=(112, 112))
    config = preset("paper").with_values({"refinement.acceptance": "whole"})
    maps = lfgpu.estimate_depth(lf, config=config, disparity_range=RANGE, device="cpu").stages
    before, after = (lfgpu.evaluate(maps[stage], lf.truth.disparity) for stage in ("propagate", "refine"))
    assert after.badpix_07 > 1.2 * before.badpix_07


def test_what_is_accepted_lies_between_both_maps(target: Any) -> None:
    lf = scenes.make("boxes", grid=(5, 5), size=(40, 48))
    kernels, device = target.kernels, Device(target.kernels, target.device)
    config = preset("paper").with_values({"refinement.longest_change": 0.05})
    assert isinstance(config, SynthesisConfig)
    measured = method_of(config).measure(lf, device, disparity_range=RANGE)
    plan = SynthesisPlan(lf.layout, measured, config, device)
    views = kernels.image(lf.views, target.device)
    for work in plan.stages(views).values():
        work(None)
    maps = plan.maps()
    moved = np.abs(maps["refine"] - maps["propagate"])
    longest = 0.05 * noise_in_units(measured) / 2  # in the farthest view, 2 view steps away
    assert moved.max() <= longest + 1e-6
    assert (moved == 0).mean() > 0.1
    assert (moved > 1e-4).mean() > 0.1
