"""Solvers against problems whose answers are known: dense systems, quadratics, a bounded valley, the propagation."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lfgpu._backends import load
from lfgpu.config import PriorConfig, PropagationConfig
from lfgpu.errors import LightFieldError
from lfgpu.initial import Local, propagate
from lfgpu.prior import NonLocalMeans
from lfgpu.solvers.cg import conjugate_gradients
from lfgpu.solvers.lbfgsb import minimize_lbfgsb
from lfgpu.solvers.solution import Solution

REFERENCE = load("reference")
SHAPE = (4, 6)


def assert_sentence(status: str) -> None:
    assert status.endswith(".")
    assert len(status.split()) >= 6


# --- conjugate gradients ---


def positive_definite(rng: np.random.Generator, size: int, condition: float) -> np.ndarray:
    basis, _ = np.linalg.qr(rng.normal(size=(size, size)))
    return basis * np.geomspace(1, condition, size) @ basis.T


def solve(
    matrix: np.ndarray, right: np.ndarray, target: Any, start: np.ndarray | None = None, **options: Any
) -> Solution:
    """`conjugate_gradients` for a dense matrix on a backend."""
    kernels = target.kernels

    def apply(x: Any, result_out: Any) -> None:
        product = (matrix @ kernels.numpy(x).astype(np.float64).ravel()).reshape(SHAPE)
        kernels.copy(kernels.field(product, target.device), result_out)

    options = {"tolerance": 1e-6, "max_iterations": 500} | options
    return conjugate_gradients(
        apply,
        kernels.field(right.reshape(SHAPE), target.device),
        np.zeros(SHAPE) if start is None else start.reshape(SHAPE),
        1 / np.diag(matrix).reshape(SHAPE),
        kernels=kernels,
        device=target.device,
        **options,
    )


@pytest.mark.parametrize("condition", [1.0, 10.0, 300.0])
def test_cg_solves_positive_definite_systems(target: Any, condition: float, rng: np.random.Generator) -> None:
    matrix, right = positive_definite(rng, 24, condition), rng.normal(size=24)
    solution = solve(matrix, right, target)
    assert solution.converged
    assert solution.trace[-1] <= 1e-6
    residual = right - matrix @ solution.values.astype(np.float64).ravel()
    assert np.linalg.norm(residual) <= 1e-5 * condition**0.5 * np.linalg.norm(right)
    np.testing.assert_allclose(solution.values.ravel(), np.linalg.solve(matrix, right), rtol=0, atol=2e-4)
    assert solution.iterations == len(solution.trace) - 1
    assert solution.values.dtype == np.float32
    assert_sentence(solution.status)


def test_cg_says_when_the_limit_stopped_it(target: Any, rng: np.random.Generator) -> None:
    matrix, right = positive_definite(rng, 24, 1e4), rng.normal(size=24)
    solution = solve(matrix, right, target, max_iterations=3)
    assert not solution.converged
    assert (solution.iterations, solution.evaluations) == (3, 4)
    assert "limit of iterations" in solution.status


def test_cg_at_the_solution_needs_no_iteration(target: Any, rng: np.random.Generator) -> None:
    values = rng.integers(-4, 5, 24).astype(float)
    solution = solve(np.diag(np.arange(1.0, 25)), np.arange(1.0, 25) * values, target, start=values)
    assert (solution.converged, solution.iterations) == (True, 0)
    np.testing.assert_array_equal(solution.values.ravel(), values)


def test_cg_with_a_perfect_preconditioner_needs_one_iteration(target: Any, rng: np.random.Generator) -> None:
    solution = solve(np.diag(2.0 ** rng.integers(-3, 4, 24)), rng.normal(size=24), target)
    assert (solution.converged, solution.iterations) == (True, 1)


def test_cg_of_a_zero_right_side_is_zero(target: Any) -> None:
    solution = solve(np.eye(24), np.zeros(24), target)
    assert solution.converged
    assert not solution.values.any()


def test_cg_calls_back_after_each_iteration(target: Any, rng: np.random.Generator) -> None:
    calls: list[tuple[int, float]] = []
    solution = solve(
        positive_definite(rng, 24, 50.0),
        rng.normal(size=24),
        target,
        callback=lambda iteration, residual: calls.append((iteration, residual)),
    )
    assert calls == list(enumerate(solution.trace))[1:]
    assert len(calls) > 3


# --- L-BFGS-B ---

Function = Callable[[np.ndarray], tuple[float, np.ndarray]]


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


def minimise(function: Function, start: np.ndarray, bounds: tuple[float, float], **options: Any) -> Solution:
    return minimize_lbfgsb(function, start, bounds, **({"tolerance": 1e-14, "max_iterations": 2000} | options))


def test_lbfgsb_finds_the_minimum_of_a_quadratic(rng: np.random.Generator) -> None:
    minimum = rng.uniform(-1, 1, 24)
    solution = minimise(quadratic(positive_definite(rng, 24, 100.0), minimum), np.zeros(SHAPE), (-2, 2))
    assert solution.converged
    np.testing.assert_allclose(solution.values.ravel(), minimum, rtol=0, atol=1e-4)
    assert solution.values.dtype == np.float32
    assert solution.values.shape == SHAPE
    assert_sentence(solution.status)


def test_lbfgsb_finds_the_end_of_a_curved_valley(rng: np.random.Generator) -> None:
    solution = minimise(valley, rng.uniform(0.2, 0.9, SHAPE), (-2, 2))
    assert solution.converged
    np.testing.assert_allclose(solution.values, 1, rtol=0, atol=1e-3)


def test_lbfgsb_stays_within_bounds_and_presses_against_them(rng: np.random.Generator) -> None:
    seen: list[np.ndarray] = []
    minimum = np.linspace(-2, 2, 24)
    function = quadratic(np.diag(rng.uniform(1, 5, 24)), minimum)

    def watched(m: np.ndarray) -> tuple[float, np.ndarray]:
        seen.append(m.copy())
        return function(m)

    solution = minimise(watched, rng.uniform(-9, 9, SHAPE), (-0.5, 1.25))
    assert min(m.min() for m in seen) >= -0.5
    assert max(m.max() for m in seen) <= 1.25
    np.testing.assert_allclose(solution.values.ravel(), minimum.clip(-0.5, 1.25), rtol=0, atol=1e-4)


def test_lbfgsb_says_when_the_limit_stopped_it() -> None:
    solution = minimise(valley, np.zeros(SHAPE), (-2, 2), max_iterations=2)
    assert not solution.converged
    assert solution.iterations == 2
    assert "limit of iterations" in solution.status


def test_lbfgsb_blames_no_limit_when_its_line_search_finds_nothing_better(rng: np.random.Generator) -> None:
    """As with float32 near the minimum: value and gradient that contradict each other."""

    def contradictory(m: np.ndarray) -> tuple[float, np.ndarray]:
        return float((m**2).sum()), -2 * m

    solution = minimise(contradictory, rng.uniform(0.2, 0.9, SHAPE), (-2, 2))
    assert not solution.converged
    assert solution.iterations < 2000
    assert "limit of iterations" not in solution.status
    assert_sentence(solution.status)


def test_lbfgsb_without_iterations_returns_the_start() -> None:
    start = np.full(SHAPE, 0.25)
    solution = minimise(valley, start, (-2, 2), max_iterations=0)
    np.testing.assert_array_equal(solution.values, start)
    assert not solution.converged


def test_lbfgsb_trace_falls_and_is_what_is_called_back(rng: np.random.Generator) -> None:
    calls: list[tuple[int, float]] = []
    start = rng.uniform(0, 1, SHAPE)
    solution = minimise(valley, start, (-2, 2), callback=lambda iteration, value: calls.append((iteration, value)))
    assert calls == list(enumerate(solution.trace))[1:]
    assert solution.trace[0] == valley(start)[0]
    assert (np.diff(solution.trace) <= 0).all()
    assert len(calls) == solution.iterations > 5


# --- the propagation: both solvers, and the energy's normal equations written out ---

PROPAGATION_PRIOR = PriorConfig(window=5, sigma_color=0.3, sigma_gradient=0.3)


def gappy(rng: np.random.Generator, size: tuple[int, int]) -> Local:
    coherence = np.where(rng.random(size) < 0.6, rng.uniform(0.8, 1.0, size), 0.0)
    return Local(rng.uniform(-1, 1, size).astype(np.float32), coherence.astype(np.float32))


def propagated(local: Local, image: np.ndarray, target: Any, **options: Any) -> Solution:
    prior = NonLocalMeans(image, PROPAGATION_PRIOR, target.kernels, target.device)
    return propagate(local, prior, PropagationConfig(**options))


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
    prior = NonLocalMeans(image, PROPAGATION_PRIOR, REFERENCE, "cpu")
    columns = []
    for unit in np.eye(size[0] * size[1]):
        sums = np.empty(size)
        prior.neighbors(unit.reshape(size), sums)
        columns.append(sums.ravel())
    want = energy_minimum(local, np.stack(columns, axis=1))
    solution = propagated(local, image, target, tolerance=1e-6)
    np.testing.assert_allclose(solution.values, want, rtol=0, atol=2e-5)
    assert solution.converged


def test_propagation_by_cg_and_by_lbfgsb_is_the_same(target: Any, rng: np.random.Generator) -> None:
    size = (14, 17)
    image, local = rng.random((*size, 3), np.float32), gappy(rng, size)
    by_cg = propagated(local, image, target, solver="cg", tolerance=1e-6)
    by_lbfgsb = propagated(local, image, target, solver="lbfgsb", tolerance=1e-8, max_iterations=2000)
    assert np.median(np.abs(by_cg.values - by_lbfgsb.values)) < 1e-3
    assert by_cg.converged  # L-BFGS-B may end at the last bit of float32 instead


def test_propagation_stays_within_what_was_defined(target: Any, rng: np.random.Generator) -> None:
    size = (14, 17)
    local = gappy(rng, size)
    values = propagated(local, rng.random((*size, 1), np.float32), target, tolerance=1e-6).values
    defined = local.disparity[local.coherence > 0]
    assert values.min() >= defined.min() - 1e-5
    assert values.max() <= defined.max() + 1e-5


def test_propagation_of_one_defined_value_is_that_value_everywhere(target: Any, rng: np.random.Generator) -> None:
    size = (9, 8)
    disparity, coherence = np.full(size, -7.0, np.float32), np.zeros(size, np.float32)
    disparity[4, 3], coherence[4, 3] = 0.625, 0.9
    values = propagated(Local(disparity, coherence), rng.random((*size, 1), np.float32), target, tolerance=1e-6).values
    np.testing.assert_allclose(values, 0.625, rtol=0, atol=1e-4)


def test_undefined_disparities_do_not_matter(target: Any, rng: np.random.Generator) -> None:
    size = (9, 8)
    image, local = rng.random((*size, 1), np.float32), gappy(rng, size)
    other = Local(np.where(local.coherence > 0, local.disparity, np.float32(99)), local.coherence)
    a, b = (propagated(one, image, target, tolerance=1e-6).values for one in (local, other))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("solver", ["cg", "lbfgsb"])
def test_propagation_calls_back(solver: str, rng: np.random.Generator) -> None:
    prior = NonLocalMeans(rng.random((9, 8, 1), np.float32), PROPAGATION_PRIOR, REFERENCE, "cpu")
    calls: list[int] = []
    solution = propagate(
        gappy(rng, (9, 8)), prior, PropagationConfig(solver=solver), lambda iteration, _: calls.append(iteration)
    )
    assert calls == list(range(1, solution.iterations + 1))
    assert calls


def test_propagation_from_nothing_is_refused(rng: np.random.Generator) -> None:
    prior = NonLocalMeans(rng.random((9, 8, 1), np.float32), PROPAGATION_PRIOR, REFERENCE, "cpu")
    nothing = Local(np.zeros((9, 8), np.float32), np.zeros((9, 8), np.float32))
    with pytest.raises(LightFieldError, match="no pixel has a coherent estimate"):
        propagate(nothing, prior, PropagationConfig())
