"""How fast memory is: the limit that operations are held against."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from benchmarks import clock
from benchmarks.jobs import Job
from benchmarks.results import Record
from lfgpu.contract import KernelSet

NAMES = ("copy", "axpby")
_LENGTH = 1 << 26  # elements: 256 MiB of float32, more than caches hold
_BUDGET = 2.0  # seconds


def measure(job: Job, kernels: KernelSet, device: str) -> Iterator[Record]:
    """A backend's own `copy` (one array read, one written) and `axpby` (two read, one written) of long vectors."""
    item = np.dtype(kernels.dtype).itemsize
    stop, capture = clock.stopper(kernels, device), clock.capturer(kernels, device)
    # Not zeros: memory that was never written is no memory yet.
    ones = np.ones((_LENGTH // 8192, 8192), np.float32)
    x, y = kernels.field(ones, device), kernels.field(ones, device)
    del ones
    calls = {
        "copy": (2, lambda: kernels.copy(x, y)),
        "axpby": (3, lambda: kernels.axpby(0.5, x, 0.5, y, y)),
    }
    for name in job.names:
        arrays, call = calls[name]
        timed = clock.measure(call, stop, repeats=job.repeats, budget=_BUDGET, capture=capture)
        yield Record(
            "bandwidth",
            job.backend,
            job.device,
            "",
            name,
            seconds=timed.seconds,
            calls=timed.calls,
            bytes=arrays * _LENGTH * item,
            details={"captured": timed.captured},
        )


def numpy_copy(threads: int, repeats: int) -> Record:
    """NumPy's copy, each thread a part of the array: what the CPU's memory does without any backend."""
    source, target = np.ones(_LENGTH, np.float32), np.ones(_LENGTH, np.float32)
    parts = list(zip(np.array_split(source, threads), np.array_split(target, threads), strict=True))
    with ThreadPoolExecutor(threads) as pool:

        def call() -> None:
            for copied in [pool.submit(np.copyto, to, origin) for origin, to in parts]:
                copied.result()

        timed = clock.measure(call, lambda: None, repeats=repeats, budget=_BUDGET)
    return Record(
        "bandwidth",
        "numpy",
        "cpu",
        "",
        "copy",
        seconds=timed.seconds,
        calls=timed.calls,
        bytes=source.nbytes + target.nbytes,
        details={"threads": threads},
    )


def of(record: Record) -> float:
    """Bytes per second that a bandwidth record found."""
    assert record.seconds is not None
    assert record.bytes is not None
    return record.bytes / record.seconds.median


def with_limits(records: list[Record]) -> list[Record]:
    """Give each record with traffic its limit: the best bandwidth that any backend reached on the same device."""
    best: dict[str, float] = {}
    for record in records:
        if record.kind == "bandwidth" and record.seconds is not None:
            best[record.device] = max(of(record), best.get(record.device, 0.0))
    return [
        record
        if record.kind == "bandwidth" or record.bytes is None or not math.isfinite(best.get(record.device, math.inf))
        else replace(record, limit=record.bytes / best[record.device])
        for record in records
    ]
