"""The refinement's energy on scenes with a known map: both solvers end in the same place."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from solver_runs import Found, Solver, assert_sentence

from lfgpu import scenes
from lfgpu.contract import Device
from lfgpu.data.lightfield import LightField
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.structure_tensor import LocalEstimator
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.energy import Energy
from lfgpu.methods.synthesis.model import ForwardModel
from lfgpu.methods.synthesis.propagation import Propagation
from lfgpu.metrics import evaluate
from lfgpu.solvers.lbfgs import BoundedLbfgs
from lfgpu.solvers.lbfgsb import ScipyLbfgsb

RANGE, TIGHT = (-1.5, 1.5), (-0.5, 0.75)
PARAMETERS = SynthesisConfig().with_values({"prior.window": 7, "refinement.smoothness": 0.2})
SCENES = ("relief", "boxes")


class Problem(NamedTuple):
    """The energy that the refinement of a light field minimises on a device, and its start."""

    lf: LightField
    target: Any
    energy: Energy
    start: np.ndarray

    def solved(
        self, solver: Solver, bounds: tuple[float, float] = RANGE, callback: Any = None, **options: Any
    ) -> Found:
        kernels, device = self.target.kernels, self.target.device
        config = PARAMETERS.refinement
        limits = {"tolerance": config.tolerance, "max_iterations": config.max_iterations} | options
        minimizer = solver(self.lf.size, bounds, Device(kernels, device), **limits)
        x = kernels.field(self.start, device)
        minimizer.minimize(self.energy, x, callback, curvature=self.energy.curvature)
        return Found(kernels.numpy(x), minimizer.report())

    def value(self, x: np.ndarray) -> float:
        kernels, device = self.target.kernels, self.target.device
        gradient, value = kernels.zeros(self.lf.size, device), kernels.scalar(0.0, device)
        self.energy(kernels.field(x, device), gradient, value)
        return float(kernels.number(value))


@cache
def problem(scene: str, target: Any) -> Problem:
    lf = scenes.make(scene, grid=(5, 5), size=(52, 56))
    kernels, device = target.kernels, Device(target.kernels, target.device)
    views = kernels.image(lf.views, target.device)
    local = LocalEstimator(lf.layout, RANGE, PARAMETERS.local, device)
    local.run(views)
    prior = NonLocalMeans((*lf.size, lf.channels), PARAMETERS.prior, device)
    prior.load(kernels.image(lf.image(lf.reference_index), target.device))
    propagation = Propagation(lf.size, RANGE, prior, PARAMETERS.propagation)
    propagation.run(local.disparity, local.coherence)
    model = ForwardModel(lf.layout, PARAMETERS.refinement, device)
    model.load(views, propagation.filled)
    energy = Energy(model, prior, PARAMETERS.refinement.smoothness)
    energy.load()
    return Problem(lf, target, energy, kernels.numpy(propagation.filled))


@pytest.mark.parametrize("scene", SCENES)
def test_lbfgs_ends_as_low_as_scipy(target: Any, scene: str) -> None:
    """With the default tolerance, at which both stop before the minimum.

    On the way down more pixels of `boxes` get wrong, so ours lie between scipy's and those of scipy further down.
    """
    case = problem(scene, target)
    own, scipy = (case.solved(solver) for solver in (BoundedLbfgs, ScipyLbfgsb))
    further = case.solved(ScipyLbfgsb, tolerance=1e-5)
    first, lowest = scipy.solution.trace[0], scipy.solution.trace[-1]
    assert own.solution.trace[0] == pytest.approx(first, rel=1e-6)
    assert lowest < 0.95 * first
    assert own.solution.trace[-1] <= 1.005 * lowest
    truth = case.lf.reference_truth()
    assert truth is not None
    found, want, later = (evaluate(solved.values, truth.disparity) for solved in (own, scipy, further))
    assert found.mse_100 == pytest.approx(want.mse_100, rel=0.05, abs=0.01)
    least, most = sorted((want.badpix_07, later.badpix_07))
    assert least - 2.0 <= found.badpix_07 <= most + 1.0
    assert found.badpix_03 == pytest.approx(want.badpix_03, abs=3.0)
    assert own.solution.converged
    assert scipy.solution.converged


@pytest.mark.parametrize("scene", SCENES)
def test_refinement_falls_within_bounds_that_hold_it_and_says_so(target: Any, scene: str) -> None:
    case = problem(scene, target)
    calls: list[tuple[int, float]] = []
    values, solution = case.solved(BoundedLbfgs, TIGHT, lambda *call: calls.append(call))
    assert np.float32(TIGHT[0]) == values.min()
    assert values.max() == np.float32(TIGHT[1])
    assert (np.diff(solution.trace) < 0).all()
    assert calls == list(enumerate(solution.trace))[1:]
    assert solution.evaluations > solution.iterations > 5
    assert solution.trace[0] == pytest.approx(case.value(case.start.clip(*TIGHT)), rel=1e-6)
    assert solution.trace[-1] == pytest.approx(case.value(values), rel=1e-6)
    assert_sentence(solution.status)
    assert f"after {solution.iterations} iterations: the energy no longer falls" in solution.status
    scipy = case.solved(ScipyLbfgsb, TIGHT)
    assert solution.trace[-1] <= 1.005 * scipy.solution.trace[-1]


def test_refinement_stops_at_its_limit(target: Any) -> None:
    case = problem("relief", target)
    for most in (0, 1, 4):
        values, solution = case.solved(BoundedLbfgs, max_iterations=most)
        assert (solution.converged, solution.iterations) == (False, most)
        assert ("limit of iterations" if most else "no iteration was allowed") in solution.status
        if most == 0:
            np.testing.assert_array_equal(values, case.start.clip(*np.float32(RANGE)))


def test_refinement_from_its_own_minimum_gains_nothing(target: Any) -> None:
    case = problem("relief", target)
    minimum, first = case.solved(BoundedLbfgs, tolerance=1e-7, max_iterations=1000)
    values, again = case._replace(start=minimum).solved(BoundedLbfgs)
    assert again.iterations <= 10
    assert first.trace[-1] * (1 - 1e-3) <= again.trace[-1] <= again.trace[0] <= first.trace[-1] * (1 + 1e-6)
    assert np.abs(values - minimum).max() < 0.01
