"""The solver of the reference backend against independent truths: minima found otherwise, the dense update."""

import numpy as np
import pytest
import solver_cases
from test_reference import REFERENCE


def quadratic_of(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, solver_cases.Function]:
    """A, b, and xᵀ A x / 2 - bᵀ x with its gradient."""
    matrix, aim = solver_cases.quadratic(count, rng)

    def function(x: np.ndarray) -> tuple[float, np.ndarray]:
        gradient = matrix @ x.ravel() - aim
        return float(x.ravel() @ (gradient - aim)) / 2, gradient.reshape(x.shape)

    return matrix, aim, function


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
