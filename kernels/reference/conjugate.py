"""A step of conjugate gradients: NumPy, float64. A number is an array of shape [1]."""

import numpy as np

from lfgpu.contract import Float64Array as Array


def conjugate_step(p: Array, q: Array, preconditioner: Array, rz: Array, x: Array, r: Array, go_on: Array) -> None:
    pq = float(np.vdot(p, q))
    alpha = rz[0] / pq if pq != 0 and go_on[0] > 0 else 0.0
    x += alpha * p
    r -= alpha * q
    z = preconditioner * r
    left = float(np.vdot(r, z))
    p[:] = z + (left / rz[0] if rz[0] != 0 else 0.0) * p
    rz[0] = left
