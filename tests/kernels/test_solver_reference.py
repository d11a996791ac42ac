"""The solver of the reference backend against independent truths: minima found otherwise, the dense update."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import solver_cases
from lfgpu.kernels.reference.lbfgs import projected_gradient
from scipy.optimize import lsq_linear, minimize
from test_reference import REFERENCE


def minimized(
    function: solver_cases.Function, start: np.ndarray, bounds: tuple[float, float], **options: Any
) -> tuple[np.ndarray, list[float]]:
    """The minimum that L-BFGS finds within `bounds`, and its trace."""
    low, high = bounds
    given = {"memory": 8, "first_step": 0.05, "tolerance": 1e-15, "patience": 10, "most": 500, **options}
    solver = REFERENCE.lbfgs(start.shape, "cpu", low=low, high=high, **given)
    x, trial = start.clip(low, high), np.empty_like(start)
    first, gradient = function(x)
    value = np.array([first])
    solver.begin(x, gradient, value)
    while solver.go_on[0]:
        solver.propose(x, trial)
        trial_value, trial_gradient = function(trial)
        solver.judge(value, np.array([trial_value]))
        solver.learn(x, gradient, trial, trial_gradient)
    return x, solver.report()[0]


def quadratic_of(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, solver_cases.Function]:
    """A, b, and xᵀ A x / 2 - bᵀ x with its gradient."""
    matrix, aim = solver_cases.quadratic(count, rng)

    def function(x: np.ndarray) -> tuple[float, np.ndarray]:
        gradient = matrix @ x.ravel() - aim
        return float(x.ravel() @ (gradient - aim)) / 2, gradient.reshape(x.shape)

    return matrix, aim, function


def test_lbfgs_finds_the_minimum_of_a_quadratic_within_bounds(rng: np.random.Generator) -> None:
    matrix, aim, function = quadratic_of(30, rng)
    start = rng.normal(size=(5, 6))
    root = np.linalg.cholesky(matrix)  # ‖Rᵀ x - R⁻¹ b‖² = xᵀ A x - 2 bᵀ x + a constant
    want = lsq_linear(root.T, np.linalg.solve(root, aim), bounds=(-0.25, 0.5), method="bvls").x
    found, trace = minimized(function, start, (-0.25, 0.5))
    assert ((want == -0.25) | (want == 0.5)).mean() > 0.1
    np.testing.assert_allclose(found.ravel(), want, rtol=0, atol=1e-6)
    assert (np.diff(trace) <= 0).all()


def test_lbfgs_finds_the_minimum_of_a_quadratic_without_bounds(rng: np.random.Generator) -> None:
    matrix, aim, function = quadratic_of(30, rng)
    found, trace = minimized(function, rng.normal(size=(5, 6)), (-100.0, 100.0))
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(matrix, aim), rtol=0, atol=1e-6)
    assert len(trace) < 100


def test_lbfgs_is_about_as_fast_as_scipy_in_a_curved_valley() -> None:
    case = solver_cases.LbfgsCase("valley", function="rosenbrock", size=(2, 3), bounds=(-2.0, 2.0))
    function = solver_cases.bounded_function(case, np.random.default_rng(0))
    start = np.full(case.size, -1.25)
    found, trace = minimized(function, start, case.bounds)
    want = minimize(
        lambda x: (function(x.reshape(case.size))[0], function(x.reshape(case.size))[1].ravel()),
        start.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=[case.bounds] * 6,
        options={"ftol": 1e-14, "gtol": 1e-9},
    )
    value, gradient = function(found)
    assert np.abs(projected_gradient(found, gradient, *case.bounds)).max() < 1e-4
    assert value <= want.fun + 1e-6
    assert len(trace) < 3 * want.nit + 20


def test_lbfgs_direction_is_that_of_the_dense_update(rng: np.random.Generator) -> None:
    """BFGS written out: H ← (1 - s yᵀ / yᵀ s) H (1 - y sᵀ / yᵀ s) + s sᵀ / yᵀ s, from H = (sᵀ y / yᵀ y) 1."""
    *_, function = quadratic_of(12, rng)
    options = {"low": -100.0, "high": 100.0, "first_step": 0.05, "tolerance": 0.0, "patience": 100, "most": 100}
    solver = REFERENCE.lbfgs((3, 4), "cpu", memory=5, **options)
    x, trial = rng.normal(size=(3, 4)), np.empty((3, 4))
    value, gradient = function(x)
    held = np.array([value])
    solver.begin(x, gradient, held)
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(4):
        before, slope = x.copy().ravel(), gradient.copy().ravel()
        solver.propose(x, trial)
        trial_value, trial_gradient = function(trial)
        solver.judge(held, np.array([trial_value]))
        solver.learn(x, gradient, trial, trial_gradient)
        if (x.ravel() != before).any():
            pairs.append((x.ravel() - before, gradient.ravel() - slope))
    s, y = pairs[-1]
    inverse = np.eye(12) * (s @ y) / (y @ y)
    for s, y in pairs:
        left = np.eye(12) - np.outer(s, y) / (s @ y)
        inverse = left @ inverse @ left.T + np.outer(s, s) / (s @ y)
    solver.propose(x, trial)
    np.testing.assert_allclose((trial - x).ravel(), -inverse @ gradient.ravel(), rtol=1e-9, atol=1e-12)


def test_lbfgs_shortens_to_the_minimum_of_the_parabola() -> None:
    """From 1 along -2, by a step of 0.8 with the slope -4; what the solver is told about the trials is not accepted."""
    options = {"low": -9.0, "high": 9.0, "tolerance": 0.0, "patience": 3, "most": 9}
    solver = REFERENCE.lbfgs((1, 1), "cpu", memory=3, first_step=1.6, **options)
    x, gradient, trial, value = np.ones((1, 1)), np.full((1, 1), 2.0), np.empty((1, 1)), np.array([1.0])
    solver.begin(x, gradient, value)
    solver.propose(x, trial)
    assert trial[0, 0] == pytest.approx(1 - 1.6)
    solver.judge(value, np.array([2.0]))  # 1 - 4 t + a t² is 2 at t = 0.8: a = 6.5625, least at 4 / (2 a)
    solver.propose(x, trial)
    assert trial[0, 0] == pytest.approx(1 - 2 * 4 / (2 * 6.5625))
    solver.judge(value, np.array([np.inf]))
    solver.propose(x, trial)
    assert trial[0, 0] == pytest.approx(1 - 0.1 * 2 * 4 / (2 * 6.5625))
    assert solver.report() == ([1.0], 3, False)


def test_residuals_are_relative_roots() -> None:
    trace = REFERENCE.residuals("cpu", tolerance=0.25, most=3)
    trace.begin(np.array([4.0]))
    going = []
    for residual in (4.0, 1.0, 0.25):
        trace.add(np.array([residual]))
        going.append(float(trace.go_on[0]))
    assert trace.report() == [1.0, 0.5, 0.25]
    assert going == [1.0, 1.0, 0.0]
