"""Time to find the disparity range and the noise of a light field before its estimate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from statistics import median
from typing import Any

import numpy as np

from benchmarks import cases, clock
from benchmarks.cases import Case
from benchmarks.options import Backends, Cases, DeviceName, Out, Preset, Row, Seconds, collected, listed, places, say
from benchmarks.tables import Columns, Table
from lfgpu import LightField
from lfgpu.contract import Device, KernelSet
from lfgpu.methods import method_of
from lfgpu.methods.disparity_range import find_disparity_range

_WAITS = ("numpy", "number", "read")
"""Operations for which the host waits."""


COLUMNS: Columns = {
    "case": "{case}",
    "backend": "{backend} {device}",
    "range, ms": "{range_ms:.1f}",
    "resident, ms": "{resident_ms:.1f}",
    "noise, ms": "{noise_ms:.1f}",
    "first, ms": "{first_ms:.1f}",
    "waits": "{waits}",
    "found / true span": lambda row: f"{float(np.ptp(row['found']) / np.ptp(row['true'])):.2f}",
}


class _Counting:
    """A backend that counts how often the host waits for it."""

    def __init__(self, kernels: KernelSet) -> None:
        self._kernels, self.waits = kernels, 0

    def __getattr__(self, name: str) -> Any:
        self.waits += name in _WAITS
        return getattr(self._kernels, name)


def command(
    case_names: Cases = "9x9x512x512",
    preset: Preset = "accurate",
    backends: Backends = "warp",
    seconds: Seconds = 5.0,
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Time the search for the disparity range and the noise before an estimate, from host to host."""
    rows = run([cases.parse(name) for name in listed(case_names)], preset, listed(backends), device, seconds)
    Table.of("", 2, collected(rows, out, benchmark="measuring"), COLUMNS).show()


def run(
    chosen: Sequence[Case], preset: str, backends: Sequence[str], device: str | None, seconds: float
) -> Iterator[Row]:
    """Measure all cases on all backends that have the device, each time for so many seconds at most.

    Times of a row are medians in milliseconds, from host to host. `range_ms` finds the range of views that lie on the
    host, `resident_ms` of views that are on the device already, `noise_ms` measures the noise within the range that was
    found. `first_ms` is the first call of a process, kernels loaded or compiled included. `waits` counts how often the
    host waits for the device while it finds the range.
    """
    for case in chosen:
        say(f"{case.name}: casting a scene")
        lf = case.make("boxes", seed=0, noise=0.005)
        for place in places(backends, device):
            say(f"{case.name} {place.kernels.name} {place.name}")
            yield _measured(case, lf, preset, place, seconds)


def _measured(case: Case, lf: LightField, preset: str, device: Device, seconds: float) -> Row:
    assert lf.truth is not None
    start = time.perf_counter()
    found = find_disparity_range(lf, device)
    first = time.perf_counter() - start
    views, method = device.image(lf.views), method_of(preset)
    counting: Any = _Counting(device.kernels)
    find_disparity_range(lf, Device(counting, device.name), views=views)

    def timed(work: Callable[[], object]) -> float:
        work()
        return 1000 * median(clock.singly(work, least=3, most=50, budget=seconds))

    return {
        "case": case.name,
        "backend": device.kernels.name,
        "device": device.name,
        "range_ms": timed(lambda: find_disparity_range(lf, device)),
        "resident_ms": timed(lambda: find_disparity_range(lf, device, views=views)),
        "noise_ms": timed(lambda: method.measured(lf, found, device)),
        "first_ms": 1000 * first,
        "waits": counting.waits,
        "found": found,
        "true": (float(lf.truth.disparity.min()), float(lf.truth.disparity.max())),
    }
