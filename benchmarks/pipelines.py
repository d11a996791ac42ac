"""The whole method: time, stages, memory, and the error of the map against the exact truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks import clock, memory, scene
from benchmarks.jobs import Job
from benchmarks.results import Record
from lfgpu import DepthResult, estimate_depth, evaluate
from lfgpu.depth import STAGES

ERRORS = ("mse_100", "badpix_07", "badpix_03", "badpix_01", "q25")
_BUDGET = 30.0  # seconds for the repeats, of which there are at least 2


def measure(job: Job, gpu_before: int | None) -> Iterator[Record]:
    """Estimate depth with each preset that is named, the range found from the views.

    The first estimate warms up, and is when a GPU is asked for its memory; the others are timed.
    """
    lf = scene.load(Path(job.scene))
    assert lf.truth is not None
    for preset in job.names:

        def run(config: str = preset) -> DepthResult:
            return estimate_depth(lf, config=config, backend=job.backend, device=job.device)

        memory.reset_host_peak()
        if gpu_before is None:
            gpu, result = None, run()
        else:
            with memory.GpuPeak() as peak:
                result = run()
            gpu = None if peak.bytes is None else peak.bytes - gpu_before
        seconds: list[float] = []
        stages: dict[str, list[float]] = {stage: [] for stage in STAGES}
        end = perf_counter() + _BUDGET
        while len(seconds) < min(2, job.repeats) or (len(seconds) < job.repeats and perf_counter() < end):
            start = perf_counter()
            result = run()
            seconds.append(perf_counter() - start)
            for stage, times in stages.items():
                times.append(result.timings[stage])
        metrics = evaluate(result.disparity, lf.truth.disparity)
        yield Record(
            "pipeline",
            job.backend,
            job.device,
            job.case,
            preset,
            seconds=clock.spread(seconds),
            errors={name: getattr(metrics, name) for name in ERRORS},
            compared=f"exact truth, {metrics.count} pixels",
            host_bytes=memory.host_peak(),
            gpu_bytes=gpu,
            details={
                "stages": {stage: median(times) for stage, times in stages.items()},
                "iterations": len(result.trace) - 1,
                "converged": result.converged,
                "status": result.status,
                "disparity_range": list(result.disparity_range),
            },
        )
