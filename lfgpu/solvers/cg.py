"""Conjugate gradients with a diagonal preconditioner, on a backend's vectors (Hestenes and Stiefel 1952)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfgpu.solvers.solution import Solution
from lfgpu.types import Array, Float32Array, Float64Array, KernelSet


def conjugate_gradients(
    apply: Callable[[Array, Array], None],
    right_side: Array,
    start: Float32Array | Float64Array,
    preconditioner: Float32Array | Float64Array,
    *,
    kernels: KernelSet,
    device: str,
    tolerance: float,
    max_iterations: int,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    """Solve A x = b for a symmetric positive definite A.

    Parameters
    ----------
    apply
        apply(x, result_out) writes A x; both are fields [y, x].
    right_side
        b, a field.
    start
        First guess [y, x].
    preconditioner
        An approximate inverse of A's diagonal [y, x], > 0.
    tolerance
        Stop when the residual r = b - A x is as small: √(rᵀ M r) <= tolerance * √(bᵀ M b), M the preconditioner. In
        this norm a weakly tied unknown counts as much as a strongly tied one.
    max_iterations
        Stop after as many.
    callback
        Called as callback(iteration, √(rᵀ M r) / √(bᵀ M b)).
    """
    shape = start.shape
    x, inverse = kernels.field(start, device), kernels.field(preconditioner, device)
    r, z, p, q = (kernels.zeros(shape, device) for _ in range(4))
    apply(x, r)
    kernels.axpby(1.0, right_side, -1.0, r, r)
    kernels.multiply(inverse, r, z)
    kernels.copy(z, p)
    rz = kernels.dot(r, z)
    kernels.multiply(inverse, right_side, q)
    norm = np.sqrt(kernels.dot(right_side, q)) or 1.0
    trace = [float(np.sqrt(rz) / norm)]
    while trace[-1] > tolerance and len(trace) <= max_iterations:
        apply(p, q)
        alpha = rz / kernels.dot(p, q)
        kernels.axpby(1.0, x, alpha, p, x)
        kernels.axpby(1.0, r, -alpha, q, r)
        kernels.multiply(inverse, r, z)
        rz, previous = kernels.dot(r, z), rz
        kernels.axpby(1.0, z, rz / previous, p, p)
        trace.append(float(np.sqrt(rz) / norm))
        if callback is not None:
            callback(len(trace) - 1, trace[-1])
    iterations, converged = len(trace) - 1, trace[-1] <= tolerance
    reason = "the residual is small enough" if converged else "the limit of iterations is reached"
    return Solution(
        kernels.numpy(x).astype(np.float32),
        converged,
        f"conjugate gradients stopped after {iterations} iterations: {reason} ({trace[-1]:.1e}).",
        iterations,
        iterations + 1,
        tuple(trace),
    )
