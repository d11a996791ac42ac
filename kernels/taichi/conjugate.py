"""A step of conjugate gradients in one launch."""

from typing import Any

import numpy as np
import taichi as ti

from .memory import DeviceArray, doubles, flat
from .runtime import double, once, run
from .sums import BLOCK, PARTS, parts, share, summing


@once
def _kernel() -> Any:
    real, sums, field = double(), summing(), flat()

    @ti.kernel
    def conjugate_kernel(
        p: field,
        q: field,
        preconditioner: field,
        rz: flat(real),
        x: field,
        r: field,
        go_on: flat(real),
        parts: flat(real),
        shares: flat(real),
    ):
        """Write α and β to `shares` on the way."""
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.turns):
            sums.keep_product(p, q, turn, parts)
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.threads):
            total = sums.total(parts, 0, PARTS, turn)
            if turn == 0:
                shares[0] = 0.0
                if total != 0.0 and go_on[0] > 0.0:
                    shares[0] = rz[0] / total
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.turns):
            i, step, end = share(turn, sums.turns, x.shape[0], sums.cpu)
            alpha = ti.cast(shares[0], ti.f32)
            term = ti.cast(0.0, real)
            while i < end:
                x[i] = x[i] + alpha * p[i]
                left = r[i] - alpha * q[i]
                r[i] = left
                term += ti.cast(left, real) * ti.cast(preconditioner[i] * left, real)
                i += step
            sums.keep(term, turn, parts)
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.threads):
            total = sums.total(parts, 0, PARTS, turn)
            if turn == 0:
                shares[1] = 0.0
                if rz[0] != 0.0:
                    shares[1] = total / rz[0]
                rz[0] = total
        for i in range(x.shape[0]):
            p[i] = preconditioner[i] * r[i] + ti.cast(shares[1], ti.f32) * p[i]

    return conjugate_kernel


@once
def _shares() -> DeviceArray:
    return doubles(np.zeros(2))


def conjugate_step(
    p: DeviceArray,
    q: DeviceArray,
    preconditioner: DeviceArray,
    rz: DeviceArray,
    x: DeviceArray,
    r: DeviceArray,
    go_on: DeviceArray,
) -> None:
    run(_kernel(), p, q, preconditioner, rz, x, r, go_on, parts(), _shares())
