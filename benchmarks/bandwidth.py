"""Bandwidth of memory: the limit of operations."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from benchmarks import clock
from benchmarks.job import Job
from benchmarks.results import Record
from lfgpu._backends import open_device

_LENGTH = 1 << 26  # elements: 256 MiB of float32, more than caches hold
_BUDGET = 2.0  # seconds


def measure(job: Job) -> Iterator[Record]:
    """Time a backend's `copy` (one array read, one written) and `axpby` (two read, one written) of long vectors."""
    device = open_device(job.backend, job.device)
    kernels = device.kernels
    # Not zeros: memory that was never written is no memory yet.
    ones = np.ones((_LENGTH // 8192, 8192), np.float32)
    x, y = device.field(ones), device.field(ones)
    del ones
    for name, arrays, call in (
        ("copy", 2, lambda: kernels.copy(x, y)),
        ("axpby", 3, lambda: kernels.axpby(0.5, x, 0.5, y, y)),
    ):
        timed = clock.measure_on(device, call, repeats=job.repeats, budget=_BUDGET)
        size = arrays * _LENGTH * np.dtype(kernels.dtype).itemsize
        details = {"captured": timed.captured}
        yield job.record(name, seconds=timed.seconds, calls=timed.calls, bytes=size, details=details)


def numpy_copy(threads: int, repeats: int) -> Record:
    """Time NumPy's copy, each thread a part of the array: the CPU's memory without any backend."""
    source, target = np.ones(_LENGTH, np.float32), np.ones(_LENGTH, np.float32)
    parts = list(zip(np.array_split(source, threads), np.array_split(target, threads), strict=True))
    with ThreadPoolExecutor(threads) as pool:

        def call() -> None:
            for copied in [pool.submit(np.copyto, to, origin) for origin, to in parts]:
                copied.result()

        timed = clock.measure(call, lambda: None, repeats=repeats, budget=_BUDGET)
    size, details = source.nbytes + target.nbytes, {"threads": threads}
    job = Job("bandwidth", "numpy", "cpu", "", "copy", repeats)
    return job.record(seconds=timed.seconds, calls=timed.calls, bytes=size, details=details)


def of(record: Record) -> float:
    """Return the bytes per second of a bandwidth record."""
    assert record.seconds is not None
    assert record.bytes is not None
    return record.bytes / record.seconds.median


def with_limits(records: list[Record]) -> list[Record]:
    """Give each record with bytes its limit: their time at the best bandwidth of any backend on the same device."""
    best: dict[str, float] = {}
    for record in records:
        if record.kind == "bandwidth" and record.seconds is not None:
            best[record.device] = max(of(record), best.get(record.device, 0.0))
    return [
        record
        if record.kind == "bandwidth" or record.bytes is None or record.device not in best
        else replace(record, limit=record.bytes / best[record.device])
        for record in records
    ]
