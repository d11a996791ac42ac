"""Light fields in a second on several GPUs of one host, one process (or thread) for each, as in `lfgpu batch`.

Each has a pipeline that is there, and goes through the same views again and again: up to the device, estimated, and the
map back (`frames`); or estimated only (`resident`), which leaves the host out. All begin at the same moment and go on
for the same time. Where `frames` scales worse than `resident`, the host is the reason: its memory, or the links.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import typer

from benchmarks import cases
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError
from benchmarks.options import Cases, Out, Presets, Row, collected, listed, say
from benchmarks.tables import Columns, Table
from lfgpu import DepthPipeline, LightField, get_threads, set_threads
from lfgpu._backends import load
from lfgpu.methods import configured

MODES = ("frames", "resident")
KINDS = ("processes", "threads")

_RANGE = (-2.0, 2.0)  # that of the scene with a margin; to look for it is no part of a stream
_WARM_UP = 4


@dataclass(frozen=True)
class Plan:
    """The measurements to make: every case with every preset on the first so many devices."""

    cases: tuple[Case, ...]
    presets: tuple[str, ...]
    devices: tuple[str, ...]
    counts: tuple[int, ...]
    kind: str = "processes"
    seconds: float = 5.0


COLUMNS: Columns = {
    "light field": "{case}",
    "preset": "{preset}",
    "mode": "{mode}",
    "devices": "{devices}",
    "light fields / s": "{rate:.1f}",
    "efficiency": lambda row: f"{100 * row['efficiency']:.0f} %",
    "ms each": "{milliseconds:.2f}",
}


def command(
    case_names: Cases = "7x7x375x375,9x9x512x512",
    presets: Presets = "fast,accurate",
    devices: Annotated[str, typer.Option(metavar="NAME,...", help="Default: all GPUs, or the CPU.")] = "",
    counts: Annotated[str, typer.Option(metavar="N,...", help="On how many of them; default: 1, 2, 4 and all.")] = "",
    how: Annotated[str, typer.Option(metavar="KIND", help=f"{' or '.join(KINDS)}, one for each device.")] = KINDS[0],
    seconds: Annotated[float, typer.Option(min=0, help="For each measurement.")] = 5,
    out: Out = None,
) -> None:
    """Measure light fields in a second on 1, 2, 4 .. GPUs of this machine."""
    names = tuple("cuda:0" if n == "cuda" else n for n in listed(devices)) or devices_here()
    chosen = tuple(cases.parse(n) for n in listed(case_names))
    plan = Plan(chosen, tuple(listed(presets)), names, gpu_counts(counts, len(names)), how, seconds)
    Table.of("", 3, collected(run(plan), out, benchmark="scaling"), COLUMNS).show()


def devices_here() -> tuple[str, ...]:
    """Name all GPUs, or the CPU."""
    found = load("warp").devices()
    return tuple(name for name in found if name != "cpu") or ("cpu",)


def gpu_counts(text: str, there: int) -> tuple[int, ...]:
    """Return the numbers in a text; of an empty one 1, 2, 4 and all."""
    return tuple(int(n) for n in listed(text)) or tuple(sorted({1, *(n for n in (2, 4) if n <= there), there}))


def run(plan: Plan) -> Iterator[Row]:
    """Measure, row by row. BenchmarkError if more devices are asked for than there are.

    `rate` is light fields in a second of all devices together, `efficiency` that over the rate of one device times
    their number, `milliseconds` the median of one light field on one device, `threads` those of the CPU for each.
    """
    if max(plan.counts) > len(plan.devices):
        raise BenchmarkError(f"there are {len(plan.devices)} devices, not {max(plan.counts)}; give fewer as --counts.")
    if plan.kind not in KINDS:
        raise BenchmarkError(f"--how must be one of {', '.join(KINDS)}, not {plan.kind!r}.")
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        for case in plan.cases:
            path = Path(folder, f"{case.name}.npz")
            say(f"casting {case.name}")
            cases.cast(case, path)
            for preset, mode in product(plan.presets, MODES):
                alone: float | None = None
                for count in plan.counts:
                    say(f"{case.name} {preset} {mode} on {count}")
                    rate, each, threads = _together(plan, path, preset, mode, count)
                    alone = rate / count if alone is None else alone
                    what = {"case": case.name, "preset": preset, "mode": mode, "kind": plan.kind, "devices": count}
                    found = {"rate": rate, "efficiency": rate / (count * alone), "milliseconds": 1e3 * each}
                    yield {**what, **found, "threads": threads}


def _together(plan: Plan, path: Path, preset: str, mode: str, count: int) -> tuple[float, float, int]:
    """Measure light fields in a second of `count` devices, the median seconds of one, and the threads of each."""
    threads = max(1, get_threads() // count)
    executor: Executor
    if plan.kind == "processes":
        context = multiprocessing.get_context("spawn")  # a process that began with CUDA must not be forked
        barrier = context.Barrier(count)
        executor = ProcessPoolExecutor(count, context, _prepare, (barrier, threads))
    else:
        _prepare(threading.Barrier(count), get_threads())
        executor = ThreadPoolExecutor(count)
    measured = partial(_measure, str(path), preset, mode, plan.seconds)
    with executor:
        waiting = [executor.submit(measured, device) for device in plan.devices[:count]]
        found = [future.result() for future in waiting]
    rate = sum(len(times) / sum(times) for times in found)
    return rate, median(t for times in found for t in times), threads


_BARRIER: Any = None
_ALONE = threading.Lock()


def _prepare(barrier: Any, threads: int) -> None:
    global _BARRIER
    _BARRIER = barrier
    set_threads(threads)


def _measure(path: str, preset: str, mode: str, seconds: float, device: str) -> list[float]:
    """Time one light field after the other on one device, while the others are at work; seconds."""
    with _ALONE:  # to capture work concerns all threads of a process
        frame = _ready(cases.load(Path(path)), preset, mode, device)
    _BARRIER.wait()
    times, begin = [], perf_counter()
    while perf_counter() - begin < seconds:
        before = perf_counter()
        frame()
        times.append(perf_counter() - before)
    return times


def _ready(lf: LightField, preset: str, mode: str, device: str) -> Callable[[], None]:
    """Make a pipeline, warm it up, and return the work of one light field."""
    pipeline = DepthPipeline(lf, config=configured(preset), disparity_range=_RANGE, device=device)
    stop = pipeline.kernels.scalar(0.0, pipeline.device)

    def frame() -> None:
        if mode == "frames":
            pipeline.upload(lf.views)
        pipeline.run()
        if mode == "frames":
            pipeline.disparity()
        else:
            pipeline.kernels.number(stop)

    for _ in range(_WARM_UP):
        frame()
    return frame
