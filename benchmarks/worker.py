"""A process that measures one job: `python -m benchmarks.worker JOB RECORDS`.

It ends at the first thing that fails, because a device may be of no use afterwards; whoever started it starts another
one for the rest.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks import accuracy, bandwidth, cases, clock, memory, operations, pipelines
from benchmarks.jobs import Job, append_record, read_job
from benchmarks.prepare import prepare, whole
from benchmarks.results import Record
from lfgpu._backends import load, pick_device
from lfgpu.contract import KernelSet

_BUDGET = 3.0  # seconds for the repeats of one operation


def main() -> None:
    """Measure the job and write a record for each of its names."""
    job, out = read_job(Path(sys.argv[1])), Path(sys.argv[2])
    records, done = _measure(job), 0
    try:
        for record in records:
            append_record(out, record)
            done += 1
    except Exception as error:  # whatever a backend raises: it is listed, and the other cases go on
        append_record(out, job.failed(job.names[done], _sentence(error)))
        sys.exit(1)


def _measure(job: Job) -> Iterator[Record]:
    gpu_before = memory.gpu_used() if job.device != "cpu" else None
    kernels = load(job.backend)
    device = pick_device(kernels, job.device)
    if job.kind == "bandwidth":
        yield from bandwidth.measure(job, kernels, device)
    elif job.kind == "pipeline":
        yield from pipelines.measure(job, gpu_before)
    else:
        for name in job.names:
            yield _operation(job, name, kernels, device, gpu_before)
            gc.collect()


def _operation(job: Job, name: str, kernels: KernelSet, device: str, gpu_before: int | None) -> Record:
    operation, case = operations.find(name), cases.find(job.case)
    memory.reset_host_peak()
    prepared = prepare(operation, kernels, device, case, whole(case))
    prepared.work.begin()
    timed = clock.measure(
        prepared.work.call,
        clock.stopper(kernels, device),
        repeats=job.repeats,
        budget=_BUDGET,
        capture=clock.capturer(kernels, device),
    )
    host = memory.host_peak()
    gpu = None if gpu_before is None else memory.gpu_used()  # all arrays are still there
    prepared.once()
    error, compared = accuracy.compare(operation, case, prepared, kernels, device)
    return Record(
        "operation",
        job.backend,
        job.device,
        job.case,
        name,
        seconds=timed.seconds,
        calls=timed.calls,
        bytes=operation.traffic(case, device),
        errors={"relative": error},
        compared=compared,
        host_bytes=host,
        gpu_bytes=None if gpu is None or gpu_before is None else gpu - gpu_before,
        details={"stop": timed.stop, "captured": timed.captured, "tolerance": operation.tolerance(device)},
    )


def _sentence(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return "the memory does not suffice"
    text = " ".join(str(error).split()) or "no reason given"
    return f"{type(error).__name__}: {text[:200]}"


main()
