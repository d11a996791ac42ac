"""Sums of many terms in numbers of type `double`: parts of them first, then the parts, always in the same order."""

from types import SimpleNamespace

import taichi as ti

from .memory import DeviceArray, empty, flat
from .runtime import double, on_cpu, once, run

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
    real = double()
    doubles = flat(real)

    @ti.kernel
    def total_kernel(parts: doubles, groups_out: doubles, totals_out: doubles):
        """Sum the parts of each total, as many for each, which lie one after the other."""
        totals = totals_out.shape[0]
        for i in range(totals * _GROUPS):
            first, step, end = share(i % _GROUPS, _GROUPS, parts.shape[0] // totals, cpu)
            begin = i // _GROUPS * (parts.shape[0] // totals)
            total = ti.cast(0.0, real)
            k = first
            while k < end:
                total += parts[begin + k]
                k += step
            groups_out[i] = total
        for i in range(totals):
            total = ti.cast(0.0, real)
            for group in range(_GROUPS):
                total += groups_out[i * _GROUPS + group]
            totals_out[i] = total

    @ti.kernel
    def product_kernel(x: flat(), y: flat(), parts_out: doubles):
        for part in range(parts_out.shape[0]):
            i, step, end = share(part, parts_out.shape[0], x.shape[0], cpu)
            total = ti.cast(0.0, real)
            while i < end:
                total += ti.cast(x[i], real) * ti.cast(y[i], real)
                i += step
            parts_out[part] = total

    return SimpleNamespace(total=total_kernel, product=product_kernel)


class Total:
    """Adds up the parts [totals * k] of each of some totals [totals], all of the type `double`."""

    def __init__(self, totals: int = 1) -> None:
        self._kernel, self._groups = _kernels(on_cpu()).total, empty((totals * _GROUPS,), scalar=double())

    def __call__(self, parts: DeviceArray, totals_out: DeviceArray) -> None:
        run(self._kernel, parts.values, self._groups.values, totals_out.values)


@once
def summing() -> tuple[DeviceArray, Total]:
    """Return memory for the partial sums of one total, and what adds them up."""
    return empty((_CPU_PARTS if on_cpu() else GPU_PARTS,), scalar=double()), Total()


def dot(a: DeviceArray, b: DeviceArray, product_out: DeviceArray) -> None:
    parts, total = summing()
    run(_kernels(on_cpu()).product, a.values, b.values, parts.values)
    total(parts, product_out)
