"""The whole method: time, stages, memory, its energy, and the error of the map against the exact truth.

`paper` is `estimate_depth` with that preset, all set-up included. `resident` is what comes after the set-up: views go
up to a pipeline that is there, and the map comes back. `scipy` is the same with scipy's L-BFGS-B in the refinement, as
in the paper: how low an energy a solver should reach. `surest`, `accurate`, `fast`: `resident` with these.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

from benchmarks import cases, clock, memory, scoring, stages
from benchmarks.job import Job
from benchmarks.results import Record, Spread
from lfgpu import PRESETS, DepthPipeline, DepthResult, LightField, estimate_depth, evaluate
from lfgpu._backends import backend_named
from lfgpu.methods import configured, method_of

SCRATCH, RESIDENT, SCIPY = "paper", "resident", "scipy"
MATCHING = "surest", "accurate", "fast"
NAMES = SCRATCH, RESIDENT, SCIPY, *MATCHING
_BUDGET = 30.0  # seconds for the repeats, of which there are at least 2
_WARM_UP = 3  # runs: the second one captures the work of a GPU, the third is the first of what was captured
_WARM_UP_BUDGET = 10.0  # seconds; on a CPU, where nothing is captured, fewer runs will do
_WARM_UP_ON_GPU = 1.5  # seconds, in which its clock rises; not fewer runs, though

Done = TypeVar("Done")


@dataclass(frozen=True)
class _Measured:
    seconds: Spread
    result: DepthResult
    stages: dict[str, float]
    gpu_peak: int | None
    details: dict[str, Any] = field(default_factory=dict)


def measure(job: Job) -> Iterator[Record]:
    """Estimate depth in the way that the job names, the range found from the views.

    The first runs are when a GPU is asked for its memory; they are not timed.
    """
    gpu_before = memory.gpu_used() if job.device != "cpu" else None
    lf = cases.load(Path(job.scene))
    assert lf.truth is not None
    memory.reset_host_peak()
    done = (_from_scratch if job.name == SCRATCH else _resident)(job, lf, look=gpu_before is not None)
    metrics = evaluate(done.result.disparity, lf.truth.disparity)
    energy = {} if job.name in MATCHING else {"energy": done.result.trace[-1]}
    yield job.record(
        seconds=done.seconds,
        errors={**scoring.errors(metrics), **energy},
        compared=f"exact truth, {metrics.count} pixels",
        host_bytes=memory.host_peak(),
        gpu_bytes=None if done.gpu_peak is None or gpu_before is None else done.gpu_peak - gpu_before,
        details={
            "stages": done.stages,
            "iterations": len(done.result.trace) - method_of(done.result.config).traced.has_start,
            "converged": done.result.converged,
            "status": done.result.status,
            "disparity_range": list(done.result.disparity_range),
            **done.details,
        },
    )


def _from_scratch(job: Job, lf: LightField, *, look: bool) -> _Measured:
    backend = backend_named(job.backend)
    run = partial(estimate_depth, lf, config=configured(job.name), backend=backend, device=job.device)
    result, peak = _with_peak(run, look)
    times: dict[str, list[float]] = {stage.name: [] for stage in method_of(job.name).stages}

    def timed() -> None:
        nonlocal result
        result = run()
        for stage, seconds in times.items():
            seconds.append(result.timings[stage])

    seconds = clock.singly(timed, least=min(2, job.repeats), most=job.repeats, budget=_BUDGET)
    return _Measured(clock.spread(seconds), result, {stage: median(t) for stage, t in times.items()}, peak)


def _resident(job: Job, lf: LightField, *, look: bool) -> _Measured:
    config = PRESETS[job.name if job.name in MATCHING else "paper"]
    if job.name == SCIPY:
        config = config.with_values({"refinement.solver": "lbfgsb"})
    on_gpu = job.device != "cpu"

    def made() -> DepthPipeline:
        pipeline = DepthPipeline(lf, config=config, backend=backend_named(job.backend), device=job.device)
        _warm_up(partial(stages.frame, pipeline, lf.views), repeats=job.repeats, on_gpu=on_gpu)
        return pipeline

    pipeline, peak = _with_peak(made, look)
    least = job.repeats if on_gpu and job.name != SCIPY else min(2, job.repeats)
    seconds = clock.singly(partial(stages.frame, pipeline, lf.views), least=least, most=job.repeats, budget=_BUDGET)
    result = pipeline.result()
    times, captured = stages.measure(pipeline, lf.views, repeats=job.repeats)
    return _Measured(clock.spread(seconds), result, times, peak, {"captured": captured})


def _warm_up(frame: Callable[[], object], *, repeats: int, on_gpu: bool) -> None:
    if on_gpu:
        clock.singly(frame, least=_WARM_UP, most=sys.maxsize, budget=_WARM_UP_ON_GPU)
    else:
        clock.singly(frame, least=1, most=min(_WARM_UP, repeats), budget=_WARM_UP_BUDGET)


def _with_peak(run: Callable[[], Done], look: bool) -> tuple[Done, int | None]:
    """Return what `run` returns, and the peak of the GPUs' used memory meanwhile if it is to be looked at."""
    if not look:
        return run(), None
    with memory.GpuPeak() as peak:
        result = run()
    return result, peak.bytes
