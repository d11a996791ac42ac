"""Light fields in a second on several GPUs of one host: one process (or thread) for each, as `lfgpu batch` has it.

Each has a pipeline that is there, and goes through the same views again and again: up to the device, estimated, and the
map back (`frames`); or estimated only (`resident`), which leaves the host out. All begin at the same moment and go on
for the same time. Where `frames` scales worse than `resident`, the host is the reason: its memory, or the links.
"""

from __future__ import annotations

import json
import multiprocessing
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter, time
from typing import Any

from benchmarks import machine, scene
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError
from lfgpu import DepthPipeline, LightField, get_threads, set_threads
from lfgpu._backends import load
from lfgpu.io.atomic import atomic_write
from lfgpu.methods import configured

MODES = ("frames", "resident")
KINDS = ("processes", "threads")

_RANGE = (-2.0, 2.0)  # that of the scene with a margin; to look for it is no part of a stream
_WARM_UP = 4


@dataclass(frozen=True)
class Plan:
    """What is measured: every case with every preset on the first so many devices."""

    cases: tuple[Case, ...]
    presets: tuple[str, ...]
    devices: tuple[str, ...]
    counts: tuple[int, ...]
    kind: str = "processes"
    seconds: float = 5.0


@dataclass(frozen=True)
class Row:
    """What so many devices did together."""

    case: str
    preset: str
    mode: str
    kind: str
    devices: int
    rate: float
    """Light fields in a second, of all devices."""
    efficiency: float
    """Of that of one device, times their number."""
    milliseconds: float
    """Of one light field on one device, the median."""
    threads: int
    """Of the CPU for each device."""


def devices_here() -> tuple[str, ...]:
    """All GPUs, or the CPU."""
    found = load("warp").devices()
    return tuple(name for name in found if name != "cpu") or ("cpu",)


def run(plan: Plan, say: Callable[[str], None]) -> Iterator[Row]:
    """Measure, row by row. BenchmarkError if more devices are asked for than there are."""
    if max(plan.counts) > len(plan.devices):
        raise BenchmarkError(f"there are {len(plan.devices)} devices, not {max(plan.counts)}; give fewer as --counts.")
    if plan.kind not in KINDS:
        raise BenchmarkError(f"--how must be one of {', '.join(KINDS)}, not {plan.kind!r}.")
    return _rows(plan, say)


def _rows(plan: Plan, say: Callable[[str], None]) -> Iterator[Row]:
    with tempfile.TemporaryDirectory(prefix="lfgpu-benchmarks-") as folder:
        for case in plan.cases:
            path = Path(folder, f"{case.name}.npz")
            say(f"casting {case.name}")
            scene.make(case, path)
            for preset in plan.presets:
                for mode in MODES:
                    alone: float | None = None
                    for count in plan.counts:
                        say(f"{case.name} {preset} {mode} on {count}")
                        rate, each, threads = _together(plan, path, preset, mode, count)
                        alone = rate / count if alone is None else alone
                        share = rate / (count * alone)
                        yield Row(case.name, preset, mode, plan.kind, count, rate, share, 1e3 * each, threads)


def table(rows: list[Row]) -> str:
    """As Markdown."""
    lines = [
        "| light field | preset | what | devices | light fields / s | efficiency | ms each |",
        "|---|---|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {row.case} | {row.preset} | {row.mode} | {row.devices} | {row.rate:.1f} | {100 * row.efficiency:.0f} % | "
        f"{row.milliseconds:.2f} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def save(rows: Sequence[Any], path: Path) -> None:
    """Write them as JSON with the machine that they are of; whole or not at all."""
    content: dict[str, Any] = {
        "date": time(),
        "machine": machine.describe(),
        "versions": machine.versions(),
        "commit": machine.commit(),
        "load": machine.load_average(),
        "rows": [asdict(row) for row in rows],
    }
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _together(plan: Plan, path: Path, preset: str, mode: str, count: int) -> tuple[float, float, int]:
    """Light fields in a second of `count` devices, the median seconds of one, and the threads of each."""
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
    """Seconds of one light field after the other on one device, while the others are at work."""
    with _ALONE:  # to capture work concerns all threads of a process
        frame = _ready(scene.load(Path(path)), preset, mode, device)
    _BARRIER.wait()
    times, begin = [], perf_counter()
    while perf_counter() - begin < seconds:
        before = perf_counter()
        frame()
        times.append(perf_counter() - before)
    return times


def _ready(lf: LightField, preset: str, mode: str, device: str) -> Callable[[], None]:
    """What takes one light field through a pipeline that is warm."""
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
