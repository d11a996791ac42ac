"""Solvers against problems whose answers are known, and against each other on the energies of the method."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.data.lightfield import LightField
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.sections import PriorConfig
from lfgpu.methods.structure_tensor import LocalEstimator
from lfgpu.methods.synthesis.config import PropagationConfig, SynthesisConfig
from lfgpu.methods.synthesis.energy import Energy
from lfgpu.methods.synthesis.model import ForwardModel
from lfgpu.methods.synthesis.propagation import Propagation
from lfgpu.metrics import evaluate
from lfgpu.solvers.cg import ConjugateGradients
from lfgpu.solvers.lbfgs import BoundedLbfgs
from lfgpu.solvers.lbfgsb import ScipyLbfgsb
from lfgpu.solvers.solution import Solution

REFERENCE = load("reference")
SHAPE = (4, 6)


class Found(NamedTuple):
    """What a solver left on the device, and what it says about it."""

    values: np.ndarray
    solution: Solution


def assert_sentence(status: str) -> None:
    assert status.endswith(".")
    assert len(status.split()) >= 6


# --- conjugate gradients ---


def positive_definite(rng: np.random.Generator, size: int, condition: float) -> np.ndarray:
    basis, _ = np.linalg.qr(rng.normal(size=(size, size)))
    return basis * np.geomspace(1, condition, size) @ basis.T


class DenseSystems:
    """`ConjugateGradients` for dense matrices on a backend."""

    def __init__(self, target: Any, *, tolerance: float = 1e-6, max_iterations: int = 500) -> None:
        self._kernels, self._device = target.kernels, target.device
        self._solver = ConjugateGradients(
            SHAPE, self._kernels, self._device, tolerance=tolerance, max_iterations=max_iterations
        )

    def solve(
        self,
        matrix: np.ndarray,
        right: np.ndarray,
        start: np.ndarray | None = None,
        callback: Callable[[int, float], None] | None = None,
    ) -> Found:
        k = self._kernels

        def apply(x: Any, result_out: Any) -> None:
            k.upload((matrix @ k.numpy(x).astype(np.float64).ravel()).reshape(SHAPE), result_out)

        def field(values: np.ndarray) -> Any:
            return k.field(values.reshape(SHAPE), self._device)

        x = field(np.zeros(SHAPE) if start is None else start)
        self._solver.solve(apply, field(right), field(1 / np.diag(matrix)), x, callback)
        return Found(k.numpy(x).ravel(), self._solver.report())


@pytest.mark.parametrize("condition", [1.0, 10.0, 300.0])
def test_cg_solves_positive_definite_systems(target: Any, condition: float, rng: np.random.Generator) -> None:
    matrix, right = positive_definite(rng, 24, condition), rng.normal(size=24)
    values, solution = DenseSystems(target).solve(matrix, right)
    assert solution.converged
    assert solution.trace[-1] <= 1e-6
    residual = right - matrix @ values.astype(np.float64)
    assert np.linalg.norm(residual) <= 1e-5 * condition**0.5 * np.linalg.norm(right)
    np.testing.assert_allclose(values, np.linalg.solve(matrix, right), rtol=0, atol=2e-4)
    assert solution.iterations == len(solution.trace) - 1
    assert_sentence(solution.status)


def test_cg_says_when_the_limit_stopped_it(target: Any, rng: np.random.Generator) -> None:
    matrix, right = positive_definite(rng, 24, 1e4), rng.normal(size=24)
    _, solution = DenseSystems(target, max_iterations=3).solve(matrix, right)
    assert not solution.converged
    assert (solution.iterations, solution.evaluations) == (3, 4)
    assert "limit of iterations" in solution.status


def test_cg_at_the_solution_needs_no_iteration(target: Any, rng: np.random.Generator) -> None:
    start = rng.integers(-4, 5, 24).astype(float)
    values, solution = DenseSystems(target).solve(np.diag(np.arange(1.0, 25)), np.arange(1.0, 25) * start, start)
    assert (solution.converged, solution.iterations) == (True, 0)
    np.testing.assert_array_equal(values, start)


def test_cg_with_a_perfect_preconditioner_needs_one_iteration(target: Any, rng: np.random.Generator) -> None:
    _, solution = DenseSystems(target).solve(np.diag(2.0 ** rng.integers(-3, 4, 24)), rng.normal(size=24))
    assert (solution.converged, solution.iterations) == (True, 1)


def test_cg_of_a_zero_right_side_is_zero(target: Any) -> None:
    values, solution = DenseSystems(target).solve(np.eye(24), np.zeros(24))
    assert solution.converged
    assert not values.any()


def test_cg_calls_back_after_each_iteration(target: Any, rng: np.random.Generator) -> None:
    calls: list[tuple[int, float]] = []
    matrix, right = positive_definite(rng, 24, 50.0), rng.normal(size=24)
    _, solution = DenseSystems(target).solve(matrix, right, callback=lambda *call: calls.append(call))
    assert calls == list(enumerate(solution.trace))[1:]
    assert len(calls) > 3


def test_cg_remembers_nothing_of_the_system_before(target: Any, rng: np.random.Generator) -> None:
    systems = DenseSystems(target)
    first, second = ((positive_definite(rng, 24, 30.0), rng.normal(size=24)) for _ in range(2))
    systems.solve(*first)
    values, solution = systems.solve(*second)
    fresh = DenseSystems(target).solve(*second)
    np.testing.assert_allclose(values, fresh.values, rtol=0, atol=1e-6)
    assert solution.trace == pytest.approx(fresh.solution.trace, rel=1e-3, abs=1e-7)


# --- minimisation within bounds: known functions, by both solvers ---

Function = Callable[[np.ndarray], tuple[float, np.ndarray]]
Solver = type[BoundedLbfgs] | type[ScipyLbfgsb]

both = pytest.mark.parametrize("solver", [BoundedLbfgs, ScipyLbfgsb])


def quadratic(matrix: np.ndarray, minimum: np.ndarray) -> Function:
    def value(m: np.ndarray) -> tuple[float, np.ndarray]:
        away = m.ravel() - minimum
        return float(away @ matrix @ away), (2 * matrix @ away).reshape(m.shape)

    return value


def valley(m: np.ndarray) -> tuple[float, np.ndarray]:
    """Rosenbrock's, along each row of the map: minimum 0 at 1 everywhere."""
    a, b = m[:, :-1], m[:, 1:]
    gradient = np.zeros_like(m)
    gradient[:, :-1] += -400 * a * (b - a**2) - 2 * (1 - a)
    gradient[:, 1:] += 200 * (b - a**2)
    return float((100 * (b - a**2) ** 2 + (1 - a) ** 2).sum()), gradient


class Functions:
    """A solver for functions of NumPy arrays on a backend."""

    def __init__(self, solver: Solver, target: Any, bounds: tuple[float, float], **options: Any) -> None:
        self._kernels, self._device = target.kernels, target.device
        limits = {"tolerance": self.least_decrease, "max_iterations": 2000} | options
        self._solver = solver(SHAPE, bounds, self._kernels, self._device, **limits)

    @property
    def least_decrease(self) -> float:
        """What float32 can still tell from nothing, or float64."""
        return 1e-14 if self._kernels.dtype is np.float64 else 1e-8

    def minimize(
        self, function: Function, start: np.ndarray, callback: Callable[[int, float], None] | None = None
    ) -> Found:
        k = self._kernels

        def energy(x: Any, gradient_out: Any, value_out: Any) -> None:
            value, gradient = function(k.numpy(x).astype(np.float64))
            k.upload(gradient, gradient_out)
            k.copy(k.scalar(value, self._device), value_out)

        x = k.field(start, self._device)
        self._solver.minimize(energy, x, callback)
        return Found(k.numpy(x), self._solver.report())


def minimise(
    solver: Solver, target: Any, function: Function, start: np.ndarray, bounds: tuple[float, float], **options: Any
) -> Found:
    return Functions(solver, target, bounds, **options).minimize(function, start)


def accuracy(target: Any) -> float:
    """How near the minimum values must be; a minimum's value says half as many digits about its place."""
    return 1e-4 if target.kernels.dtype is np.float64 else 1e-3


@both
def test_minimum_of_a_quadratic_is_found(solver: Solver, target: Any, rng: np.random.Generator) -> None:
    minimum = rng.uniform(-1, 1, 24)
    function = quadratic(positive_definite(rng, 24, 100.0), minimum)
    values, solution = minimise(solver, target, function, np.zeros(SHAPE), (-2, 2))
    assert solution.converged
    np.testing.assert_allclose(values.ravel(), minimum, rtol=0, atol=accuracy(target))
    assert_sentence(solution.status)


@both
def test_end_of_a_curved_valley_is_found(solver: Solver, target: Any, rng: np.random.Generator) -> None:
    start = rng.uniform(0.2, 0.9, SHAPE)
    values, solution = minimise(solver, target, valley, start, (-2, 2))
    assert solution.converged
    left = 1e-6 if target.kernels.dtype is np.float64 else 1e-4  # float32 ends the line search of some starts earlier
    assert solution.trace[-1] < left * valley(start)[0]
    if target.kernels.dtype is np.float64:  # float32 says too little about places along so flat a floor
        np.testing.assert_allclose(values, 1, rtol=0, atol=1e-3)


@both
def test_solvers_stay_within_bounds_and_press_against_them(
    solver: Solver, target: Any, rng: np.random.Generator
) -> None:
    seen: list[np.ndarray] = []
    minimum = np.linspace(-2, 2, 24)
    function = quadratic(np.diag(rng.uniform(1, 5, 24)), minimum)

    def watched(m: np.ndarray) -> tuple[float, np.ndarray]:
        seen.append(m.copy())
        return function(m)

    values, _ = minimise(solver, target, watched, rng.uniform(-9, 9, SHAPE), (-0.5, 1.25))
    assert min(m.min() for m in seen) >= -0.5
    assert max(m.max() for m in seen) <= 1.25
    np.testing.assert_allclose(values.ravel(), minimum.clip(-0.5, 1.25), rtol=0, atol=accuracy(target))


@both
def test_solvers_say_when_the_limit_stopped_them(solver: Solver, target: Any) -> None:
    _, solution = minimise(solver, target, valley, np.zeros(SHAPE), (-2, 2), max_iterations=2)
    assert not solution.converged
    assert solution.iterations == len(solution.trace) - 1 == 2
    assert solution.evaluations >= 3
    assert "limit of iterations" in solution.status


@both
def test_no_limit_is_blamed_when_the_line_search_finds_nothing_better(
    solver: Solver, target: Any, rng: np.random.Generator
) -> None:
    """As with float32 near the minimum: value and gradient that contradict each other."""

    def contradictory(m: np.ndarray) -> tuple[float, np.ndarray]:
        return float((m**2).sum()), -2 * m

    start = rng.uniform(0.2, 0.9, SHAPE)
    values, solution = minimise(solver, target, contradictory, start, (-2, 2))
    assert solution.iterations < 2000
    assert "limit of iterations" not in solution.status
    assert_sentence(solution.status)
    if solver is BoundedLbfgs:  # scipy's steps may become so short that they change nothing: to it that is convergence
        assert not solution.converged
        assert "line search" in solution.status
    assert (values**2).sum() <= (start**2).sum() * (1 + 1e-6)


@both
def test_without_iterations_the_start_is_left(solver: Solver, target: Any) -> None:
    start = np.full(SHAPE, 0.25)
    values, solution = minimise(solver, target, valley, start, (-2, 2), max_iterations=0)
    np.testing.assert_array_equal(values, start)
    assert (solution.converged, solution.iterations, solution.evaluations) == (False, 0, 1)
    assert solution.trace == (valley(start)[0],)
    assert "no iteration was allowed" in solution.status


@both
def test_start_out_of_bounds_is_moved_into_them_first(solver: Solver, target: Any) -> None:
    values, solution = minimise(solver, target, valley, np.full(SHAPE, 9.0), (-2, 2), max_iterations=0)
    np.testing.assert_array_equal(values, np.full(SHAPE, 2.0))
    assert solution.trace == (valley(values.astype(float))[0],)


@both
def test_trace_falls_from_the_value_of_the_start(solver: Solver, target: Any, rng: np.random.Generator) -> None:
    start = rng.uniform(0, 1, SHAPE).astype(np.float32).astype(float)
    _, solution = minimise(solver, target, valley, start, (-2, 2))
    assert solution.trace[0] == valley(start)[0]
    assert (np.diff(solution.trace) <= 0).all()
    assert len(solution.trace) - 1 == solution.iterations > 5


@both
def test_solvers_call_back_after_each_iteration(solver: Solver, target: Any, rng: np.random.Generator) -> None:
    calls: list[tuple[int, float]] = []
    start = rng.uniform(-1.2, -1, SHAPE)  # the valley bends on the way from there
    _, solution = Functions(solver, target, (-2, 2)).minimize(valley, start, lambda *call: calls.append(call))
    assert solution.evaluations > solution.iterations + 1  # steps were shortened, which are no iterations
    assert calls == list(enumerate(solution.trace))[1:]


@both
@pytest.mark.parametrize("at", ["inside", "bounds"])
def test_start_exactly_at_the_minimum_stays_there(
    at: str, solver: Solver, target: Any, rng: np.random.Generator
) -> None:
    start = np.round(rng.uniform(-1, 1, SHAPE) * 2**8) / 2**8 if at == "inside" else np.full(SHAPE, 0.5)
    minimum = start.ravel() if at == "inside" else np.full(24, 3.0)  # beyond the bound
    function = quadratic(np.diag(rng.uniform(1, 5, 24)), minimum)
    values, solution = minimise(solver, target, function, start, (-1, 1) if at == "inside" else (-0.5, 0.5))
    np.testing.assert_array_equal(values, start)
    assert solution.converged
    assert solution.iterations == 0
    assert solution.trace == (function(start)[0],)
    assert_sentence(solution.status)


def test_lbfgs_remembers_nothing_of_the_function_before(target: Any, rng: np.random.Generator) -> None:
    first, second = (quadratic(positive_definite(rng, 24, 30.0), rng.uniform(-1, 1, 24)) for _ in range(2))
    used, fresh = (Functions(BoundedLbfgs, target, (-2, 2), tolerance=1e-6) for _ in range(2))
    used.minimize(first, np.zeros(SHAPE))
    again, want = (functions.minimize(second, np.zeros(SHAPE)) for functions in (used, fresh))
    np.testing.assert_allclose(again.values, want.values, rtol=0, atol=1e-5)
    assert again.solution.trace == pytest.approx(want.solution.trace, rel=1e-3, abs=1e-6)


# --- the refinement: its energy, on scenes with a known map ---

RANGE, TIGHT = (-1.5, 1.5), (-0.5, 0.75)
PARAMETERS = SynthesisConfig().with_values({"prior.window": 7, "refinement.smoothness": 0.2})
SCENES = ("relief", "boxes")


class Problem(NamedTuple):
    """What the refinement of a light field minimises on a device, and where it begins."""

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
        minimizer = solver(self.lf.size, bounds, kernels, device, **limits)
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
    kernels, where = target.kernels, (target.kernels, target.device)
    views = kernels.image(lf.views, target.device)
    local = LocalEstimator(lf, RANGE, PARAMETERS.local, *where)
    local.run(views)
    prior = NonLocalMeans((*lf.size, lf.channels), PARAMETERS.prior, *where)
    prior.load(kernels.image(lf.image(lf.reference_index), target.device))
    propagation = Propagation(lf.size, RANGE, prior, PARAMETERS.propagation)
    propagation.run(local.disparity, local.coherence)
    model = ForwardModel(lf, PARAMETERS.refinement, *where)
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
    assert least - 1.0 <= found.badpix_07 <= most + 1.0
    assert found.badpix_03 == pytest.approx(want.badpix_03, abs=3.0)
    assert own.solution.converged
    assert scipy.solution.converged


def test_lbfgs_ends_where_scipy_ends(target: Any) -> None:
    """With a tolerance at which both come to the minimum; without occlusions, so that there is one."""
    case = problem("relief", target)
    limits = {"tolerance": 1e-5, "max_iterations": 300}
    own, scipy = (case.solved(solver, **limits) for solver in (BoundedLbfgs, ScipyLbfgsb))
    assert own.solution.trace[-1] == pytest.approx(scipy.solution.trace[-1], rel=5e-3)
    apart = np.abs(own.values - scipy.values)
    assert (apart > 1e-3).mean() < 0.15
    assert (apart > 1e-2).mean() < 0.02


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


# --- the propagation: both solvers, and the energy's normal equations written out ---

PROPAGATION_PRIOR = PriorConfig(window=5, sigma_color=0.3, sigma_gradient=0.3)


class Local(NamedTuple):
    """A first estimate, maps [y, x]."""

    disparity: np.ndarray
    coherence: np.ndarray


def gappy(rng: np.random.Generator, size: tuple[int, int]) -> Local:
    coherence = np.where(rng.random(size) < 0.6, rng.uniform(0.8, 1.0, size), 0.0)
    return Local(rng.uniform(-1, 1, size).astype(np.float32), coherence.astype(np.float32))


def propagation_of(image: np.ndarray, kernels: Any, device: str, **options: Any) -> Propagation:
    prior = NonLocalMeans(image.shape, PROPAGATION_PRIOR, kernels, device)
    prior.load(kernels.image(image, device))
    return Propagation(image.shape[:2], (-1.0, 1.0), prior, PropagationConfig(**options))


def propagated(local: Local, image: np.ndarray, target: Any, **options: Any) -> Found:
    kernels, device = target.kernels, target.device
    propagation = propagation_of(image, kernels, device, **options)
    propagation.run(kernels.field(local.disparity, device), kernels.field(local.coherence, device))
    return Found(kernels.numpy(propagation.filled), propagation.report())


def energy_minimum(local: Local, weights: np.ndarray) -> np.ndarray:
    """argmin_m Σ_p Σ_q w_pq [(m_p - m_q)² + C_p (m0_p - m_q)²], term by term, q = p included."""
    n = local.disparity.size
    c, m0 = local.coherence.ravel().astype(float), local.disparity.ravel().astype(float)
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for p, q in itertools.product(range(n), repeat=2):
        w = weights[p, q]
        for a, b, sign in ((p, p, 1), (q, q, 1), (p, q, -1), (q, p, -1)):
            matrix[a, b] += sign * w
        matrix[q, q] += w * c[p]
        right[q] += w * c[p] * m0[p]
    return np.linalg.solve(matrix, right).reshape(local.disparity.shape)


def test_propagation_is_the_minimum_of_its_energy(target: Any, rng: np.random.Generator) -> None:
    size = (6, 7)
    image, local = rng.random((*size, 3), np.float32), gappy(rng, size)
    prior = NonLocalMeans(image.shape, PROPAGATION_PRIOR, REFERENCE, "cpu")
    prior.load(REFERENCE.image(image, "cpu"))
    columns = []
    for unit in np.eye(size[0] * size[1]):
        sums = np.empty(size)
        prior.neighbors(unit.reshape(size), sums)
        columns.append(sums.ravel())
    want = energy_minimum(local, np.stack(columns, axis=1))
    values, solution = propagated(local, image, target, tolerance=1e-6)
    np.testing.assert_allclose(values, want, rtol=0, atol=2e-5)
    assert solution.converged


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


def test_propagation_of_one_defined_value_is_that_value_everywhere(target: Any, rng: np.random.Generator) -> None:
    size = (9, 8)
    disparity, coherence = np.full(size, -7.0, np.float32), np.zeros(size, np.float32)
    disparity[4, 3], coherence[4, 3] = 0.625, 0.9
    values, _ = propagated(Local(disparity, coherence), rng.random((*size, 1), np.float32), target, tolerance=1e-6)
    np.testing.assert_allclose(values, 0.625, rtol=0, atol=1e-4)


def test_undefined_disparities_do_not_matter(target: Any, rng: np.random.Generator) -> None:
    size = (9, 8)
    image, local = rng.random((*size, 1), np.float32), gappy(rng, size)
    other = Local(np.where(local.coherence > 0, local.disparity, np.float32(99)), local.coherence)
    a, b = (propagated(one, image, target, tolerance=1e-6).values for one in (local, other))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("solver", ["cg", "lbfgsb"])
def test_propagation_calls_back(solver: str, rng: np.random.Generator) -> None:
    propagation = propagation_of(rng.random((9, 8, 1), np.float32), REFERENCE, "cpu", solver=solver)
    calls: list[int] = []
    propagation.run(*gappy(rng, (9, 8)), lambda iteration, _: calls.append(iteration))
    assert calls == list(range(1, propagation.report().iterations + 1))
    assert calls


def test_propagation_remembers_nothing_of_the_estimate_before(target: Any, rng: np.random.Generator) -> None:
    kernels, device, size = target.kernels, target.device, (9, 8)
    image, first, second = rng.random((*size, 1), np.float32), gappy(rng, size), gappy(rng, size)
    propagation = propagation_of(image, kernels, device, tolerance=1e-6)
    for local in (first, second):
        propagation.run(kernels.field(local.disparity, device), kernels.field(local.coherence, device))
    fresh = propagated(second, image, target, tolerance=1e-6)
    np.testing.assert_allclose(kernels.numpy(propagation.filled), fresh.values, rtol=0, atol=1e-5)


def test_propagation_says_how_much_it_was_told(target: Any, rng: np.random.Generator) -> None:
    """`trusted` is what tells that there was nothing to go by."""
    kernels, device, size = target.kernels, target.device, (9, 8)
    propagation = propagation_of(rng.random((*size, 1), np.float32), kernels, device)
    some = gappy(rng, size)
    for coherence in (np.zeros(size), some.coherence, np.zeros(size)):
        propagation.run(kernels.field(some.disparity, device), kernels.field(coherence, device))
        assert kernels.number(propagation.trusted) == pytest.approx(coherence.sum(dtype=float), rel=1e-6)
        assert np.isfinite(kernels.numpy(propagation.filled)).all()
