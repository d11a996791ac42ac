"""How many frames a second a stream takes, how late its maps are, and how right they are."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import cases
from benchmarks.moving import RANGE, Film, to_and_fro
from lfgpu import DepthPipeline, DepthStream, LightField, StreamResult, TemporalPrior, evaluate
from lfgpu.io.atomic import atomic_write

Say = Callable[[str], None]
_WARM_UP = 5  # frames
_PACE = 0.8  # of the rate that it can do, at which latency is measured: a camera leaves room
_SCORED = 3  # times through the film, whose last is scored


@dataclass(frozen=True)
class Plan:
    """What is measured: cases and presets by name, frames that are cast, seconds of each run, budget and device."""

    cases: tuple[str, ...]
    presets: tuple[str, ...]
    frames: int
    seconds: float
    budget_ms: float | None
    device: str | None


@dataclass(frozen=True)
class Row:
    """One preset on one case, warm or cold.

    `rate` is maps a second while frames are pushed as fast as they are taken ("block"); the latencies, milliseconds
    from `push` of a uint8 frame of the host to the float32 map there, are at `pace` frames a second. Errors are means
    over frames, `mse_ratio` and `bad_ratio` those of MSE and BadPix(0.07) to a cold `accurate` solve of the same.
    """

    case: str
    preset: str
    warm: bool
    device: str
    rate: float
    pace: float
    latency_p50: float
    latency_p95: float
    latency_p99: float
    work_p50: float
    dropped: int
    mse_100: float
    badpix_07: float
    mse_ratio: float
    bad_ratio: float


def save(out: Path | None, found: dict[str, Any]) -> None:
    """Write what was found as JSON, if it goes anywhere."""
    if out is not None:
        with atomic_write(out) as temporary:
            temporary.write_text(json.dumps(found, indent=1), encoding="utf-8")


def run(plan: Plan, say: Say) -> Iterator[Row]:
    """Measure all presets, cold and warm, on all cases."""
    for case in plan.cases:
        say(f"{case}: casting {plan.frames} frames")
        size = cases.parse(case)
        frames = Film(size.grid, size.size, plan.frames).frames()
        cold = _errors(frames, _solved_cold(frames, plan.device))
        for preset in plan.presets:
            for warm in (True, False):
                say(f"{case} {preset} {'warm' if warm else 'cold'}")
                yield _measured(case, preset, warm, frames, cold, plan)


def _measured(
    case: str, preset: str, warm: bool, frames: list[LightField], cold: tuple[float, float], plan: Plan
) -> Row:
    options: dict[str, Any] = {
        "config": preset,
        "disparity_range": RANGE,
        "device": plan.device,
        "prior": TemporalPrior() if warm else None,
        "budget_ms": plan.budget_ms,
    }
    views = [lf.views for lf in frames]
    with DepthStream(frames[0], policy="block", **options) as stream:
        scored = _errors(frames, _maps(stream, frames))
        rate = _rate(stream, views, plan.seconds)
    with DepthStream(frames[0], policy="latest", **options) as stream:
        pace = _PACE * rate
        seen, dropped = _paced(stream, views, pace, plan.seconds)
    latencies, work = (np.array(times) * 1000 for times in zip(*seen, strict=True))
    p50, p95, p99 = (float(value) for value in np.percentile(latencies, (50, 95, 99)))
    return Row(
        case,
        preset,
        warm,
        stream.device,
        rate,
        pace,
        p50,
        p95,
        p99,
        float(np.median(work)),
        dropped,
        *scored,
        scored[0] / cold[0],
        scored[1] / cold[1],
    )


def _maps(stream: DepthStream, frames: list[LightField]) -> list[Any]:
    """Maps of the frames after the stream has gone through them to and fro a few times."""
    there = list(range(len(frames)))
    path = list(islice(to_and_fro(there), _SCORED * (2 * len(frames) - 2) + len(frames)))
    results = [(index, stream.push(frames[index].views)) for index in path[: -len(frames)]]
    results[-1][1].wait()
    return [stream.push(frames[index].views).numpy() for index in path[-len(frames) :]]


def _solved_cold(frames: list[LightField], device: str | None) -> list[Any]:
    pipeline = DepthPipeline(frames[0], config="accurate", disparity_range=RANGE, device=device)
    maps = []
    for lf in frames:
        pipeline.upload(lf.views)
        pipeline.run()
        maps.append(pipeline.disparity())
    return maps


def _errors(frames: Sequence[LightField], maps: Sequence[Any]) -> tuple[float, float]:
    metrics = [evaluate(one, lf.truth.disparity) for one, lf in zip(maps, frames, strict=True) if lf.truth]
    return fmean(m.mse_100 for m in metrics), fmean(m.badpix_07 for m in metrics)


def _rate(stream: DepthStream, views: list[Any], seconds: float) -> float:
    """Maps a second, as fast as frames are taken."""
    coming = to_and_fro(views)
    for frame in islice(coming, _WARM_UP):
        result = stream.push(frame)
    result.wait()
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds or count < _WARM_UP:
        result = stream.push(next(coming))
        count += 1
    result.wait()
    return count / (time.perf_counter() - start)


def _paced(stream: DepthStream, views: list[Any], pace: float, seconds: float) -> tuple[list[tuple[float, float]], int]:
    """Latency and work of frames that come at that rate, and how many were dropped; each map is let go once it is seen.

    Results that are held keep their memory, and the stream would take more for each frame.
    """
    coming, pending, seen, dropped = to_and_fro(views), deque[StreamResult](), [], 0
    count = max(_WARM_UP, round(seconds * pace))
    start = time.perf_counter()
    for index in range(_WARM_UP + count + 1):
        if index < _WARM_UP + count:
            time.sleep(max(0.0, start + index / pace - time.perf_counter()))
            pending.append(stream.push(next(coming)))
        while pending and (pending[0].done or index == _WARM_UP + count):
            result = pending.popleft()
            result.wait()
            if result.index < _WARM_UP:
                continue
            if result.dropped:
                dropped += 1
            else:
                seen.append((result.latency, result.work))
    return seen, dropped


def show(rows: list[Row]) -> None:
    """A table."""
    table = Table()
    for name in ("case", "preset", "start", "maps/s", "paced at", "latency, ms", "device, ms", "dropped", "MSE x100"):
        table.add_column(name, no_wrap=True)
    table.add_column("BadPix 0.07")
    table.add_column("both to cold accurate", no_wrap=True)
    for row in rows:
        table.add_row(
            row.case,
            row.preset,
            "warm" if row.warm else "cold",
            f"{row.rate:.1f}",
            f"{row.pace:.1f}",
            " / ".join(f"{value:.2f}" for value in (row.latency_p50, row.latency_p95, row.latency_p99)),
            f"{row.work_p50:.2f}",
            str(row.dropped),
            f"{row.mse_100:.3f}",
            f"{row.badpix_07:.2f}",
            f"{row.mse_ratio:.3f} / {row.bad_ratio:.3f}",
        )
    console = Console(highlight=False)
    console.width = max(console.width, 150)
    console.print(table)
    if rows:
        console.print(
            f"On {rows[0].device}, from a uint8 frame on the host to its float32 map there; latency is the median, 95 "
            "and 99 % of frames that come at a pace."
        )
