"""A step of conjugate gradients in as few passes over its fields as its two inner products allow."""

from typing import Any

import warp as wp

from .native_code import kernel
from .threads import flat, launch, launch_tiles, once
from .vector import BLOCK, dot, partial_dot_kernel

wp.set_module_options({"enable_backward": False})

_BLOCKS = 512  # of a GPU, which share an inner product


@wp.func
def _sum_of(parts: wp.array(dtype=wp.float64), thread: int):
    """Compute the sum of the first _BLOCKS parts, which each block finds for itself, all in one order."""
    part = wp.float64(0.0)
    for i in range(thread, wp.static(_BLOCKS), wp.static(BLOCK)):
        part = part + parts[i]
    return wp.tile_extract(wp.tile_sum(wp.tile(part)), 0)


@wp.kernel
def _move_kernel(
    p: wp.array(dtype=float),
    q: wp.array(dtype=float),
    preconditioner: wp.array(dtype=float),
    rz: wp.array(dtype=wp.float64),
    parts: wp.array(dtype=wp.float64),
    go_on: wp.array(dtype=wp.float64),
    threads: int,
    x: wp.array(dtype=float),
    r: wp.array(dtype=float),
    parts_out: wp.array(dtype=wp.float64),
):
    """x and r, and parts of the next rᵀ M r; the last of them is the rᵀ M r that there was."""
    block, thread = wp.tid()
    pq = _sum_of(parts, thread)
    alpha = float(0.0)
    if pq != wp.float64(0.0) and go_on[0] > wp.float64(0.0):
        alpha = float(rz[0] / pq)
    total = wp.float64(0.0)
    for i in range(block * wp.block_dim() + thread, x.shape[0], threads):
        x[i] = x[i] + alpha * p[i]
        left = r[i] - alpha * q[i]
        r[i] = left
        total = total + wp.float64(left) * wp.float64(preconditioner[i] * left)
    wp.tile_store(parts_out, wp.tile_sum(wp.tile(total)), offset=block)
    if block == 0 and thread == 0:
        parts_out[wp.static(_BLOCKS)] = rz[0]


@wp.kernel
def _turn_kernel(
    r: wp.array(dtype=float),
    preconditioner: wp.array(dtype=float),
    parts: wp.array(dtype=wp.float64),
    threads: int,
    p: wp.array(dtype=float),
    rz_out: wp.array(dtype=wp.float64),
):
    """p, and the sum of the parts."""
    block, thread = wp.tid()
    rz = _sum_of(parts, thread)
    before = parts[wp.static(_BLOCKS)]
    beta = float(0.0)
    if before != wp.float64(0.0):
        beta = float(rz / before)
    for i in range(block * wp.block_dim() + thread, p.shape[0], threads):
        p[i] = preconditioner[i] * r[i] + beta * p[i]
    if block == 0 and thread == 0:
        rz_out[0] = rz


@once
def _parts(device: str) -> Any:
    """Partial sums of both inner products; the second one keeps its last value as well."""
    return [wp.empty(_BLOCKS + 1, dtype=wp.float64, device=device) for _ in range(2)]


def conjugate_step(p: Any, q: Any, preconditioner: Any, rz: Any, x: Any, r: Any, go_on: Any) -> None:
    device = p.device
    fields = flat(p), flat(q), flat(preconditioner), flat(x), flat(r)
    p, q, preconditioner, x, r = fields
    along, left = _parts(device.alias)
    if device.is_cpu:
        pq = along[:1]
        dot(p, q, pq)
        step = kernel("vector.h", "conjugate_step")
        launch(step, 1, [pq, q, preconditioner, go_on, rz, p, x], [r], device=device)
        return
    threads, options = _BLOCKS * BLOCK, {"dim": [_BLOCKS], "block_dim": BLOCK, "device": device}
    launch_tiles(partial_dot_kernel, inputs=[p, q, threads], outputs=[along], **options)
    moved = [p, q, preconditioner, rz, along, go_on, threads]
    launch_tiles(_move_kernel, inputs=moved, outputs=[x, r, left], **options)
    launch_tiles(_turn_kernel, inputs=[r, preconditioner, left, threads], outputs=[p, rz], **options)
