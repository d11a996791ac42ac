"""What a stream counts and how long things take, at any time and from any thread."""

from __future__ import annotations

import threading
from collections import deque
from time import perf_counter
from typing import Any

import numpy as np

_KEPT = 1024  # latest frames, of which times are known
_RECENT = 2.0  # seconds over which the frame rate is taken, if that many frames came

_HELP = {
    "frames_pushed": "Frames given to the stream.",
    "frames_done": "Frames with a result.",
    "frames_dropped": "Frames given up because there was no room or the stream was closed.",
    "frames_failed": "Frames that could not be used.",
    "frames_cold": "Results that did not start from the last map.",
    "scene_cuts": "Frames so different from the one before that they started cold.",
    "frames_with_missing_views": "Results from which some views were missing.",
    "frames_over_budget": "Results that took the device longer than the frame budget.",
    "callback_errors": "Exceptions of the callback, which were ignored.",
}


class Counters:
    """Counts and times of a stream."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = dict.fromkeys(_HELP, 0)
        self._latencies: deque[float] = deque(maxlen=_KEPT)
        self._work: deque[float] = deque(maxlen=_KEPT)
        self._ends: deque[float] = deque(maxlen=_KEPT)

    def add(self, *names: str) -> None:
        """One more of each."""
        with self._lock:
            for name in names:
                self._counts[name] += 1

    def done(self, latency: float, work: float, *names: str) -> None:
        """A frame has a result: seconds since `push`, seconds that the device worked on it, what else to count."""
        with self._lock:
            for name in ("frames_done", *names):
                self._counts[name] += 1
            self._latencies.append(latency)
            self._work.append(work)
            self._ends.append(perf_counter())

    def stats(self) -> dict[str, Any]:
        """Everything, as plain numbers."""
        with self._lock:
            counts, ends = dict(self._counts), list(self._ends)
            latencies, work = np.array(self._latencies), np.array(self._work)
        in_work = counts["frames_pushed"] - sum(counts[f"frames_{end}"] for end in ("done", "dropped", "failed"))
        return {
            **counts,
            "frames_in_work": in_work,
            "frames_per_second": _rate(ends),
            **_percentiles("latency", latencies),
            **_percentiles("work", work),
        }


def prometheus(stats: dict[str, Any], prefix: str = "lfgpu_stream") -> str:
    """Numbers in the text format that Prometheus reads (version 0.0.4)."""
    lines = []
    for name, value in stats.items():
        if name.endswith("_ms"):
            continue
        kind = "counter" if name in _HELP else "gauge"
        suffix = "_total" if kind == "counter" else ""
        if name in _HELP:
            lines.append(f"# HELP {prefix}_{name}{suffix} {_HELP[name]}")
        lines += [f"# TYPE {prefix}_{name}{suffix} {kind}", f"{prefix}_{name}{suffix} {float(value):g}"]
    for what in ("latency", "work"):
        lines.append(f"# TYPE {prefix}_{what}_seconds gauge")
        lines += [
            f'{prefix}_{what}_seconds{{quantile="{quantile / 100:g}"}} {stats[f"{what}_p{quantile}_ms"] / 1000:g}'
            for quantile in (50, 95, 99)
        ]
    return "\n".join(lines) + "\n"


def _percentiles(name: str, seconds: Any) -> dict[str, float]:
    """Of the latest frames, in milliseconds; NaN before there is one."""
    values = np.percentile(seconds * 1000, (50, 95, 99)) if len(seconds) else np.full(3, np.nan)
    return {f"{name}_p{quantile}_ms": float(value) for quantile, value in zip((50, 95, 99), values, strict=True)}


def _rate(ends: list[float]) -> float:
    """Results a second over the last seconds; 0 when none came for as long."""
    now = perf_counter()
    recent = [end for end in ends if now - end <= _RECENT]
    if len(recent) < 2:
        recent = ends[-2:]
        if len(recent) < 2 or now - recent[-1] > max(_RECENT, 2 * (recent[-1] - recent[0])):
            return 0.0
    return (len(recent) - 1) / max(recent[-1] - recent[0], 1e-9)
