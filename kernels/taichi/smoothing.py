"""Views for comparisons, smoothed and reduced; `kernels/reference/smoothing.py` says why."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import taichi as ti

from lfgpu.contract import REDUCTION, SMOOTHING_REACH, WHITE

from .memory import DeviceArray, flat, optional, scratch
from .runtime import on_cpu, once, run

_TOGETHER = 16  # views at a time on a GPU, one on a CPU
_SPREAD = 8.0  # pixels²: twice the variance of the Gaussian over places


@ti.func
def _stored(intensities):
    return ti.cast(ti.floor(WHITE * ti.math.clamp(intensities, 0.0, 1.0) + 0.5), ti.u16)


@ti.func
def _counts(valid: ti.template(), masked: ti.template(), p):
    known = True
    if ti.static(masked):
        known = valid[p] != 0.0
    return known


@once
def _kernels(channels: int, stored: Any) -> SimpleNamespace:
    views_type, pixels, out_type = flat(stored, channels), flat(channels=channels), flat(ti.u16, channels)

    @ti.kernel
    def guide_kernel(
        views: views_type,
        valid: flat(),
        masked: ti.template(),
        scale: float,
        height: int,
        width: int,
        first: int,
        count: int,
        guide_out: pixels,
    ):
        """Means over 3 x 3 pixels, those that are valid."""
        size = height * width
        for i in range(count):
            p = first + i
            y = p % size // width
            x = p % width
            total = ti.Vector([0.0] * channels)
            known = 0.0
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    row = ti.math.clamp(y + dy, 0, height - 1)
                    column = ti.math.clamp(x + dx, 0, width - 1)
                    q = p + (row - y) * width + column - x
                    if _counts(valid, masked, q):
                        total += ti.cast(views[q], ti.f32)
                        known += 1.0
            guide_out[i] = total * scale / ti.max(known, 1.0)

    @ti.kernel
    def smooth_kernel(
        views: views_type,
        valid: flat(),
        masked: ti.template(),
        scale: float,
        height: int,
        width: int,
        first: int,
        count: int,
        guide: pixels,
        unit: float,
        first_out: int,
        views_out: out_type,
    ):
        size = height * width
        for i in range(count):
            p = first + i
            y = p % size // width
            x = p % width
            total = ti.Vector([0.0] * channels)
            weights = 0.0
            likeness = ti.select(_counts(valid, masked, p), unit, 0.0)
            for dy in range(ti.max(-SMOOTHING_REACH, -y), ti.min(SMOOTHING_REACH, height - 1 - y) + 1):
                for dx in range(ti.max(-SMOOTHING_REACH, -x), ti.min(SMOOTHING_REACH, width - 1 - x) + 1):
                    q = p + dy * width + dx
                    if _counts(valid, masked, q):
                        unlike = 1.0 + likeness * (guide[q - first] - guide[i]).norm_sqr()
                        weight = ti.exp(-(dx * dx + dy * dy) / _SPREAD) / (unlike * unlike)
                        total += weight * ti.cast(views[q], ti.f32)
                        weights += weight
            views_out[first_out + i] = _stored(scale * total / ti.select(weights > 0.0, weights, 1.0))

    @ti.kernel
    def reduce_kernel(
        views: views_type,
        valid: flat(),
        masked: ti.template(),
        scale: float,
        height: int,
        width: int,
        rows: int,
        columns: int,
        views_out: out_type,
    ):
        for p in range(views_out.shape[0]):
            first = p // (rows * columns) * height * width + p // columns % rows * REDUCTION * width
            first += p % columns * REDUCTION
            total = ti.Vector([0.0] * channels)
            known = 0.0
            for dy in range(REDUCTION):
                for dx in range(REDUCTION):
                    q = first + dy * width + dx
                    if _counts(valid, masked, q):
                        total += ti.cast(views[q], ti.f32)
                        known += 1.0
            views_out[p] = _stored(scale * total / ti.max(known, 1.0))

    return SimpleNamespace(guide=guide_kernel, smooth=smooth_kernel, reduce=reduce_kernel)


@ti.kernel
def _reduce_mask_kernel(valid: flat(), height: int, width: int, rows: int, columns: int, valid_out: flat()):
    for p in range(valid_out.shape[0]):
        first = p // (rows * columns) * height * width + p // columns % rows * REDUCTION * width
        first += p % columns * REDUCTION
        every = 1.0
        for dy in range(REDUCTION):
            for dx in range(REDUCTION):
                if valid[first + dy * width + dx] == 0.0:
                    every = 0.0
        valid_out[p] = every


def smooth_views(
    views: DeviceArray,
    valid: DeviceArray | None,
    *,
    scale: float,
    deviation: float,
    views_out: DeviceArray,
    chosen: Sequence[int] | None = None,
) -> None:
    kernels, (n, height, width) = _kernels(views.channels, views.scalar), views_out.shape
    assert views.channels is not None
    unit, size = 1 / (views.channels * deviation**2), height * width
    some = min(n, 1 if on_cpu() or chosen is not None else _TOGETHER)
    guide = scratch(views_out, (some, height, width), channels=views.channels)
    for view in range(0, n, some):
        these = (view if chosen is None else chosen[view]) * size, min(some, n - view) * size
        inputs = views, *optional(valid), scale, height, width, *these, guide
        run(kernels.guide, *inputs)
        run(kernels.smooth, *inputs, unit, view * size, views_out)


def reduce_views(
    views: DeviceArray,
    valid: DeviceArray | None,
    *,
    scale: float,
    views_out: DeviceArray,
    valid_out: DeviceArray | None,
) -> None:
    (_, height, width), (_, rows, columns) = views.shape, views_out.shape
    sizes = height, width, rows, columns
    kernels = _kernels(views.channels, views.scalar)
    run(kernels.reduce, views, *optional(valid), scale, *sizes, views_out)
    if valid is not None and valid_out is not None:
        run(_reduce_mask_kernel, valid, *sizes, valid_out)
