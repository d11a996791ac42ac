"""The propagation: both solvers, and the energy's normal equations written out."""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pytest
from solver_runs import Found

from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.sections import PriorConfig
from lfgpu.methods.synthesis.config import PropagationConfig
from lfgpu.methods.synthesis.propagation import Propagation

REFERENCE = load("reference")
PRIOR = PriorConfig(window=5, sigma_color=0.3, sigma_gradient=0.3)


class Local(NamedTuple):
    """A first estimate, maps [y, x]."""

    disparity: np.ndarray
    coherence: np.ndarray


def gappy(rng: np.random.Generator, size: tuple[int, int]) -> Local:
    coherence = np.where(rng.random(size) < 0.6, rng.uniform(0.8, 1.0, size), 0.0)
    return Local(rng.uniform(-1, 1, size).astype(np.float32), coherence.astype(np.float32))


def propagation_of(image: np.ndarray, kernels: Any, device: str, **options: Any) -> Propagation:
    prior = NonLocalMeans(image.shape, PRIOR, Device(kernels, device))
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
    prior = NonLocalMeans(image.shape, PRIOR, Device(REFERENCE, "cpu"))
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
