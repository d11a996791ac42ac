"""Time of `estimate_depth` as people call it, by part, beside that of a pipeline that is there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from statistics import median
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import clock, stages
from benchmarks.options import DeviceName, Out, Presets, collected, listed, say
from benchmarks.tables import NONE, Table
from lfgpu import DepthPipeline, LightField, estimate_depth, scenes
from lfgpu._backends import load, open_device
from lfgpu.cameras import looking, screening
from lfgpu.cameras.points import Windows
from lfgpu.contract import Device
from lfgpu.data import DepthResult
from lfgpu.methods import base
from lfgpu.methods.base import Method
from lfgpu.methods.matching import method
from lfgpu.pipelines import resident, verdict

_PARTS: dict[str, tuple[Any, str]] = {
    "take": (DepthPipeline, "take"),
    "upload": (load(), "upload"),
    "measure": (Method, "measure"),
    "range": (base, "find_disparity_range"),
    "grain": (method, "measured_grain"),
    "noise": (method, "measured_noise"),
    "numbers": (DepthPipeline, "_follow_measured"),
    "plan": (DepthPipeline, "_replan"),
    "capture": (load(), "capture"),
    "estimate": (DepthPipeline, "estimate"),
    "result": (DepthPipeline, "result"),
    "verdict": (verdict, "verdict_of"),
    "screen": (looking, "worth_a_look"),
    "windows": (Windows, "rank"),
    "points": (Windows, "on_surfaces"),
    "off": (screening, "_fault"),
    "swapped": (screening, "_may_be_swapped"),
}
"""Functions that are timed. Views are uploaded and measured (range and beside it grain, noise) while the pipeline takes
them, and other numbers go to the plan, or a new plan is made; work is captured, windows of the reference view ranked,
and the result copied, within the estimate; cameras are screened for the verdict, at points in these windows, for views
that may be off, and beside that for swapped axes.
"""


_TURNS = 12  # calls for each of two scenes, the one and the other


def command(presets: Presets = "fast,accurate,learned", device: DeviceName = None, out: Out = None) -> None:
    """Time calls of `estimate_depth` by part, and compare their maps with those of calls that find nothing kept."""
    table(collected(run(listed(presets), device), out, benchmark="call")).show()


def run(presets: Sequence[str], device: str | None, side: int = 512, views: int = 9) -> Iterator[dict[str, Any]]:
    """Yield a row for each preset and call: milliseconds in all and of its parts, and whether the map is the same.

    The first call makes a pipeline, the second one captures its work. Of those that follow, for the one and the other
    scene in turn, each figure is a median.
    """
    name = open_device(device=device).name
    say(f"{name}: two scenes of {views} x {views} views of {side} x {side} px")
    one, other = (scenes.make("boxes", grid=(views, views), size=(side, side), seed=s, noise=0.004) for s in (1, 2))
    for preset in presets:
        timed = [("first", one, *_timed(one, preset, name)), ("second", one, *_timed(one, preset, name))]
        turns = [_timed(lf, preset, name) for _ in range(_TURNS) for lf in (other, one)]
        timed.append(("in turn", one, _medians([milliseconds for milliseconds, _ in turns]), turns[-1][1]))
        resident.KEPT.free()
        pipeline = DepthPipeline(one, config=preset, device=name)  # type: ignore[arg-type]
        seconds = clock.singly(partial(stages.frame, pipeline, one.views), least=8, most=8, budget=0.0)
        rounds = {"pipeline": 1e3 * min(seconds), **_asked(pipeline)}
        del pipeline
        for call, lf, milliseconds, found in timed:
            resident.KEPT.free()
            alone = estimate_depth(lf, config=preset, device=name)  # type: ignore[arg-type]
            maps = ((getattr(found, f), getattr(alone, f)) for f in ("disparity", "confidence", "uncertainty"))
            same = all(np.array_equal(*pair, equal_nan=True) for pair in maps)
            yield {"preset": preset, "call": call, **milliseconds, **rounds, "same map": same}


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Make the table."""

    def of(name: str) -> Callable[[dict[str, Any]], str]:
        return lambda row: f"{row[name]:.1f}" if name in row else NONE

    columns = {name: of(name) for name in ("all", *_PARTS, "pipeline", *_ASKED)}
    words = {name: lambda row, name=name: str(row[name]) for name in ("preset", "call", "same map")}
    return Table.of("milliseconds", 3, rows, {**words, **columns})


def _medians(times: Sequence[dict[str, float]]) -> dict[str, float]:
    """Find the median of each part, over the calls in which it happened."""
    names = dict.fromkeys(name for each in times for name in each)
    return {name: median(each[name] for each in times if name in each) for name in names}


_ASKED = "asked", "done"


def _asked(pipeline: DepthPipeline) -> dict[str, float]:
    """Time all stages, asked for one operation at a time: until the last one is asked for, and until it is done."""
    stop = clock.stopper(Device(pipeline.kernels, pipeline.device))
    stop()
    start = perf_counter()
    pipeline.work()
    asked = perf_counter()
    stop()
    return dict(zip(_ASKED, (1e3 * (asked - start), 1e3 * (perf_counter() - start)), strict=True))


def _timed(lf: LightField, preset: str, device: str) -> tuple[dict[str, float], DepthResult]:
    """Time a call and those of its parts that happen, in milliseconds."""
    times: dict[str, float] = {}

    def watched(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            start = perf_counter()
            found = function(*arguments, **options)
            times[name] = times.get(name, 0.0) + 1e3 * (perf_counter() - start)
            return found

        return call

    with ExitStack() as stack:
        for name, (home, attribute) in _PARTS.items():
            stack.enter_context(patch.object(home, attribute, watched(name, getattr(home, attribute))))
        found = watched("all", estimate_depth)(lf, config=preset, device=device)
    return times, found
