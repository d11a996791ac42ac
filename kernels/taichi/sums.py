"""Sums of many terms in float64: parts of them first, then the parts, always in the same order."""

from types import SimpleNamespace

import taichi as ti

from .memory import DeviceArray, empty, flat
from .runtime import on_cpu, once, run

GPU_PARTS = 32768
"""Partial sums of one total, a thread of a GPU each."""

_CPU_PARTS = 4096
_GROUPS = 128  # of parts, whose sums are the last step but one


@ti.func
def share(part: int, parts: int, count: int, cpu: ti.template()):
    """(first, step, end) of the indices below `count` that belong to a part: a CPU wants them together, a GPU apart."""
    first, step, end = part, parts, count
    if ti.static(cpu):
        length = (count + parts - 1) // parts
        first, step, end = ti.min(part * length, count), 1, ti.min((part + 1) * length, count)
    return first, step, end


@once
def _kernels(cpu: bool) -> SimpleNamespace:
    doubles = flat(ti.f64)

    @ti.kernel
    def total_kernel(parts: doubles, groups_out: doubles, totals_out: doubles):
        """Sum the parts of each total, as many for each, which lie one after the other."""
        totals = totals_out.shape[0]
        for i in range(totals * _GROUPS):
            first, step, end = share(i % _GROUPS, _GROUPS, parts.shape[0] // totals, cpu)
            begin = i // _GROUPS * (parts.shape[0] // totals)
            total = ti.f64(0.0)
            k = first
            while k < end:
                total += parts[begin + k]
                k += step
            groups_out[i] = total
        for i in range(totals):
            total = ti.f64(0.0)
            for group in range(_GROUPS):
                total += groups_out[i * _GROUPS + group]
            totals_out[i] = total

    @ti.kernel
    def product_kernel(x: flat(), y: flat(), parts_out: doubles):
        for part in range(parts_out.shape[0]):
            i, step, end = share(part, parts_out.shape[0], x.shape[0], cpu)
            total = ti.f64(0.0)
            while i < end:
                total += ti.cast(x[i], ti.f64) * ti.cast(y[i], ti.f64)
                i += step
            parts_out[part] = total

    return SimpleNamespace(total=total_kernel, product=product_kernel)


class Total:
    """Adds up the parts [totals * k] of each of some totals [totals], all float64."""

    def __init__(self, totals: int = 1) -> None:
        self._kernel, self._groups = _kernels(on_cpu()).total, empty((totals * _GROUPS,), scalar=ti.f64)

    def __call__(self, parts: DeviceArray, totals_out: DeviceArray) -> None:
        run(self._kernel, parts.values, self._groups.values, totals_out.values)


@once
def _room() -> tuple[DeviceArray, Total]:
    """Memory for the partial sums of a product, and their total."""
    return empty((_CPU_PARTS if on_cpu() else GPU_PARTS,), scalar=ti.f64), Total()


def dot(a: DeviceArray, b: DeviceArray, product_out: DeviceArray) -> None:
    parts, total = _room()
    run(_kernels(on_cpu()).product, a.values, b.values, parts.values)
    total(parts, product_out)
