"""Time of each part of a run of a resident pipeline by itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import median
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from benchmarks import clock
from lfgpu import DepthPipeline
from lfgpu.contract import Device, Float32Array

UPLOAD, DOWNLOAD = "upload", "download"
_MOST, _BUDGET = 10, 1.0  # repeats of each part, and seconds for them


def frame(pipeline: DepthPipeline, views: NDArray[np.generic]) -> Float32Array:
    """Take views to a map, host to host, with a pipeline that is there."""
    pipeline.upload(views)
    pipeline.run()
    return pipeline.disparity()


def measure(
    pipeline: DepthPipeline, views: NDArray[np.generic], *, repeats: int = _MOST
) -> tuple[dict[str, float], bool]:
    """Return medians in seconds, the device waited for after each part, and whether stages were captured as in a run.

    The parts are done in their order, as often as given, but no more than `_MOST` times and than fit into `_BUDGET`: a
    stage may change what an earlier one left, so that none can be repeated by itself.
    The pipeline must have run before. Where a solver of the host takes part, nothing can be captured: its stages are
    those that one more estimate tells.
    """
    kernels, device = pipeline.kernels, pipeline.device
    stop = clock.stopper(Device(kernels, device))
    parts: dict[str, Callable[[], object]] = {UPLOAD: lambda: pipeline.upload(views)}
    captured = False
    if pipeline.method.is_on_device:
        works = {name: partial(stage, None) for name, stage in pipeline.stages().items()}
        graphs = {stage: kernels.capture(work, device) for stage, work in works.items()}
        captured = None not in graphs.values()
        parts |= {stage: graphs[stage] or work for stage, work in works.items()}
    parts[DOWNLOAD] = pipeline.disparity
    times: dict[str, list[float]] = {name: [] for name in parts}

    def in_order() -> None:
        for name, part in parts.items():
            start = perf_counter()
            part()
            stop()
            times[name].append(perf_counter() - start)

    stop()
    clock.singly(in_order, least=1, most=min(repeats, _MOST), budget=_BUDGET)
    seconds = {name: median(each) for name, each in times.items()}
    if not pipeline.method.is_on_device:
        seconds |= {stage: s for stage, s in pipeline.estimate().timings.items() if stage != "total"}
    return seconds, captured
