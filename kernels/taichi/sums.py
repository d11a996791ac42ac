"""Sums of many terms in numbers of type `double`: parts of them first, then the parts, always in the same order.

A thread of a CPU, or a block of threads of a GPU, adds up each part.
"""

from types import SimpleNamespace
from typing import Any

import taichi as ti

from .memory import DeviceArray, empty, flat
from .runtime import double, on_cpu, once, run

PARTS = 1024  # of a total
BLOCK = 128  # threads of a GPU that add up a part


@ti.func
def share(turn: int, turns: int, count: int, cpu: ti.template()):
    """(first, step, end) of the indices below `count` that belong to a turn: a CPU wants them together, a GPU apart."""
    first, step, end = turn, turns, count
    if ti.static(cpu):
        length = (count + turns - 1) // turns
        first, step, end = ti.min(turn * length, count), 1, ti.min((turn + 1) * length, count)
    return first, step, end


@once
def summing() -> SimpleNamespace:
    """Return functions of kernels: `keep` writes a part of what turns of a loop added up, `total` adds up parts.

    Loops over terms take `turns` turns, in blocks of `BLOCK`: `threads` of them, one after the other, for each part,
    and as many for a total.
    """
    real, threads, cpu = double(), 1 if on_cpu() else BLOCK, on_cpu()

    @ti.func
    def whole(term, thread: int):
        """Sum the terms of a block; its first thread gets the sum."""
        total = term
        if ti.static(not cpu):
            terms = ti.simt.block.SharedArray((BLOCK,), real)
            ti.simt.block.sync()  # a block may take several parts
            terms[thread] = term  # `+=` would be atomic
            for k in ti.static(range(1, BLOCK.bit_length())):
                ti.simt.block.sync()
                if thread < BLOCK >> k:
                    terms[thread] = terms[thread] + terms[thread + (BLOCK >> k)]
            total = terms[thread]
        return total

    @ti.func
    def keep(term, turn: int, parts_out: ti.template()):
        part = whole(term, turn % threads)
        if turn % threads == 0:
            parts_out[turn // threads] = part

    @ti.func
    def keep_product(x: ti.template(), y: ti.template(), turn: int, parts_out: ti.template()):
        """Keep a part of the inner product of two fields."""
        i, step, end = share(turn, PARTS * threads, x.shape[0], cpu)
        term = ti.cast(0.0, real)
        while i < end:
            term += ti.cast(x[i], real) * ti.cast(y[i], real)
            i += step
        keep(term, turn, parts_out)

    @ti.func
    def total(parts: ti.template(), first: int, count: int, turn: int):
        """Sum the parts from `first` on; the first turn gets the sum."""
        term = ti.cast(0.0, real)
        k = turn % threads
        while k < count:
            term += parts[first + k]
            k += threads
        return whole(term, turn % threads)

    functions = {"keep": keep, "keep_product": keep_product, "total": total}
    return SimpleNamespace(threads=threads, turns=PARTS * threads, cpu=cpu, **functions)


@once
def parts() -> DeviceArray:
    """Return memory for the parts of a total, for sums that a single launch makes."""
    return empty((PARTS,), scalar=double())


@once
def _product_kernel() -> Any:
    real, sums = double(), summing()

    @ti.kernel
    def product_kernel(x: flat(), y: flat(), parts: flat(real), product_out: flat(real)):
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.turns):
            sums.keep_product(x, y, turn, parts)
        ti.loop_config(block_dim=BLOCK)
        for turn in range(sums.threads):
            total = sums.total(parts, 0, PARTS, turn)
            if turn == 0:
                product_out[0] = total

    return product_kernel


def dot(a: DeviceArray, b: DeviceArray, product_out: DeviceArray) -> None:
    run(_product_kernel(), a, b, parts(), product_out)


@once
def _totals_kernel() -> Any:
    real, sums = double(), summing()

    @ti.kernel
    def totals_kernel(parts: flat(real), totals_out: flat(real)):
        count = parts.shape[0] // totals_out.shape[0]
        ti.loop_config(block_dim=BLOCK)
        for turn in range(totals_out.shape[0] * sums.threads):
            total = sums.total(parts, turn // sums.threads * count, count, turn)
            if turn % sums.threads == 0:
                totals_out[turn // sums.threads] = total

    return totals_kernel


def add_up(parts: DeviceArray, totals_out: DeviceArray) -> None:
    """Sum the parts [totals * k] of each of some totals [totals], all of the type `double`."""
    run(_totals_kernel(), parts, totals_out)
