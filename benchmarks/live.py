"""Maps a second of a stream, their latency and their errors."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice
from statistics import fmean
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks import stages
from benchmarks.moving import RANGE, Film, to_and_fro
from benchmarks.options import Cases, DeviceName, Out, Presets, Row, collected, listed, say
from benchmarks.tables import Columns, Table
from lfgpu import DepthPipeline, DepthStream, LightField, StreamResult, TemporalPrior, evaluate

_WARM_UP = 5  # frames
_PACE = 0.8  # of the rate that it can do, at which latency is measured: a camera leaves room
_SCORED = 3  # times through the film, whose last is scored


COLUMNS: Columns = {
    "case": "{case}",
    "preset": "{preset}",
    "start": lambda row: "warm" if row["warm"] else "cold",
    "maps/s": "{rate:.1f}",
    "paced at": "{pace:.1f}",
    "latency, ms": "{latency_p50:.2f} / {latency_p95:.2f} / {latency_p99:.2f}",
    "device, ms": "{work_p50:.2f}",
    "dropped": "{dropped}",
    "MSE x100": "{mse_100:.3f}",
    "BadPix 0.07": "{badpix_07:.2f}",
    "both to cold accurate": "{mse_ratio:.3f} / {bad_ratio:.3f}",
}


def command(
    case_names: Cases = "7x7x375x375,9x9x512x512",
    presets: Presets = "accurate,fast",
    frames: Annotated[int, typer.Option(min=2, help="Number of rendered frames; they are played to and fro.")] = 8,
    seconds: Annotated[float, typer.Option(min=0.1, help="Duration of the measurement of each way.")] = 10.0,
    budget: Annotated[float | None, typer.Option(metavar="MS", help="Largest time of the device for a frame.")] = None,
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Measure frames a second, the latency from a frame on the host to its map there, and errors of warm maps."""
    options = {"device": device, "budget_ms": budget}
    rows = run(listed(case_names), listed(presets), frames, seconds, options)
    found = collected(rows, out, benchmark="live")
    Table.of("", 3, found, COLUMNS).show()
    how = "latency is the median, 95 and 99 % of frames that come at a pace."
    typer.echo(f"On {found[0]['device']}, from a uint8 frame on the host to its float32 map there; {how}")


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Make the table of a page from the rows of a file: rate, latency and errors, warm and cold."""
    columns: Columns = {
        "preset": lambda r: f"`{r['preset']}`, {'warm' if r['warm'] else 'cold'}",
        "size": lambda r: r["case"].replace("x", " × "),
        "maps / s": "{rate:.0f}",
        "latency, ms: median, 95 %, 99 %": "{latency_p50:.1f}, {latency_p95:.1f}, {latency_p99:.1f}",
        "MSE, BadPix(0.07) to a cold `accurate`": "{mse_ratio:.2f}, {bad_ratio:.2f}",
    }
    return Table.of("", 2, rows, columns)


def run(
    case_names: Sequence[str], presets: Sequence[str], count: int, seconds: float, options: dict[str, Any]
) -> Iterator[Row]:
    """Measure all presets, cold and warm, on `count` frames of all cases; `options` are further ones of `DepthStream`.

    `rate` is maps a second while frames are pushed as fast as they are taken ("block"); the latencies, milliseconds
    from `push` of a uint8 frame of the host to the float32 map there, are at `pace` frames a second. Errors are means
    over frames, `mse_ratio` and `bad_ratio` those of MSE and BadPix(0.07) to a cold `accurate` solve of the same.
    """
    for case in case_names:
        say(f"{case}: casting {count} frames")
        frames = Film.of(case, count).frames()
        cold = _errors(frames, _solved_cold(frames, options["device"]))
        for preset in presets:
            for warm in (True, False):
                say(f"{case} {preset} {'warm' if warm else 'cold'}")
                prior = TemporalPrior() if warm else None
                given = {**options, "config": preset, "disparity_range": RANGE, "prior": prior}
                what = {"case": case, "preset": preset, "warm": warm}
                yield what | _measured(frames, cold, seconds, given)


def _measured(frames: list[LightField], cold: tuple[float, float], seconds: float, options: dict[str, Any]) -> Row:
    views = [lf.views for lf in frames]
    with DepthStream(frames[0], policy="block", **options) as stream:
        scored = _errors(frames, _maps(stream, frames))
        rate = _rate(stream, views, seconds)
    with DepthStream(frames[0], policy="latest", **options) as stream:
        pace = _PACE * rate
        seen, dropped = _paced(stream, views, pace, seconds)
    latencies, work = (np.array(times) * 1000 for times in zip(*seen, strict=True))
    return {
        **{"device": stream.device, "rate": rate, "pace": pace},
        **{f"latency_p{share}": float(np.percentile(latencies, share)) for share in (50, 95, 99)},
        **{"work_p50": float(np.median(work)), "dropped": dropped, "mse_100": scored[0], "badpix_07": scored[1]},
        **{"mse_ratio": scored[0] / cold[0], "bad_ratio": scored[1] / cold[1]},
    }


def _maps(stream: DepthStream, frames: list[LightField]) -> list[Any]:
    """Take the maps of the frames after the stream has gone through them to and fro a few times."""
    there = list(range(len(frames)))
    path = list(islice(to_and_fro(there), _SCORED * (2 * len(frames) - 2) + len(frames)))
    results = [(index, stream.push(frames[index].views)) for index in path[: -len(frames)]]
    results[-1][1].wait()
    return [stream.push(frames[index].views).numpy() for index in path[-len(frames) :]]


def _solved_cold(frames: list[LightField], device: str | None) -> list[Any]:
    pipeline = DepthPipeline(frames[0], config="accurate", disparity_range=RANGE, device=device)
    return [stages.frame(pipeline, lf.views) for lf in frames]


def _errors(frames: Sequence[LightField], maps: Sequence[Any]) -> tuple[float, float]:
    metrics = [evaluate(one, lf.truth.disparity) for one, lf in zip(maps, frames, strict=True) if lf.truth]
    return fmean(m.mse_100 for m in metrics), fmean(m.badpix_07 for m in metrics)


def _rate(stream: DepthStream, views: list[Any], seconds: float) -> float:
    """Measure maps a second, as fast as frames are taken."""
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
    """Measure latency and work of frames that come at that rate, and count those dropped; each map is let go once seen.

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
