"""What it takes to measure a light field before its estimate: its disparity range, and its noise."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import clock
from benchmarks.cases import Case
from lfgpu import LightField, scenes
from lfgpu._backends import load, pick_device
from lfgpu.contract import KernelSet
from lfgpu.errors import BackendError
from lfgpu.methods import method_of
from lfgpu.methods.disparity_range import find_disparity_range

Say = Callable[[str], None]

_WAITS = ("numpy", "number")
"""Operations for which the host waits."""


@dataclass(frozen=True)
class Row:
    """One case on one backend and device; times are medians in milliseconds, from host to host.

    `range_ms` finds the range of views that lie on the host, `resident_ms` of views that are on the device already,
    `noise_ms` measures the noise within the range that was found. `first_ms` is the first call of a process, kernels
    loaded or compiled included. `waits` counts how often the host waits for the device while it finds the range.
    """

    case: str
    backend: str
    device: str
    range_ms: float
    resident_ms: float
    noise_ms: float
    first_ms: float
    waits: int
    found: tuple[float, float]
    true: tuple[float, float]


class _Counting:
    """A backend that counts how often the host waits for it."""

    def __init__(self, kernels: KernelSet) -> None:
        self._kernels, self.waits = kernels, 0

    def __getattr__(self, name: str) -> Any:
        self.waits += name in _WAITS
        return getattr(self._kernels, name)


def run(
    cases: tuple[Case, ...], preset: str, backends: tuple[str, ...], device: str | None, say: Say, *, seconds: float
) -> list[Row]:
    """Measure all cases on all backends that have the device, each time for so many seconds at most."""
    rows = []
    for case in cases:
        say(f"{case.name}: casting a scene")
        lf = scenes.make("boxes", grid=case.grid, size=case.size, seed=0, noise=0.005)
        for backend in backends:
            try:
                kernels = load(backend)
                place = pick_device(kernels, device)
            except BackendError as error:
                say(f"{case.name} {backend}: {error}")
                continue
            say(f"{case.name} {backend} {place}")
            rows.append(_measured(case, lf, preset, kernels, place, seconds))
    return rows


def _measured(case: Case, lf: LightField, preset: str, kernels: KernelSet, device: str, seconds: float) -> Row:
    assert lf.truth is not None
    start = time.perf_counter()
    found = find_disparity_range(lf, kernels, device)
    first = time.perf_counter() - start
    views, method = kernels.image(lf.views, device), method_of(preset)
    counting: Any = _Counting(kernels)
    find_disparity_range(lf, counting, device, views=views)

    def timed(work: Callable[[], object]) -> float:
        work()
        return 1000 * median(clock.singly(work, least=3, most=50, budget=seconds))

    return Row(
        case.name,
        kernels.name,
        device,
        timed(lambda: find_disparity_range(lf, kernels, device)),
        timed(lambda: find_disparity_range(lf, kernels, device, views=views)),
        timed(lambda: method.measured(lf, found, kernels, device)),
        1000 * first,
        counting.waits,
        found,
        (float(lf.truth.disparity.min()), float(lf.truth.disparity.max())),
    )


def show(rows: list[Row]) -> None:
    """A table."""
    table = Table()
    for name in (
        "case",
        "backend",
        "range, ms",
        "resident, ms",
        "noise, ms",
        "first, ms",
        "waits",
        "found / true span",
    ):
        table.add_column(name, justify="right")
    for row in rows:
        times = (f"{ms:.1f}" for ms in (row.range_ms, row.resident_ms, row.noise_ms, row.first_ms))
        share = float(np.ptp(row.found) / np.ptp(row.true))
        table.add_row(row.case, f"{row.backend} {row.device}", *times, str(row.waits), f"{share:.2f}")
    Console().print(table)
