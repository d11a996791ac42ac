"""Statistics of a stream: counts and times."""

from __future__ import annotations

import threading
from collections import deque
from time import perf_counter
from typing import Any

import numpy as np

_KEPT = 1024  # latest frames whose times are kept
_RECENT = 2.0  # seconds over which the frame rate is averaged

_HELP = {
    "frames_pushed": "Frames given to the stream.",
    "frames_done": "Frames with a result.",
    "frames_dropped": "Frames dropped because they came too fast or the stream was closed.",
    "frames_failed": "Frames that failed.",
    "frames_cold": "Results that did not start from the previous map.",
    "scene_cuts": "Frames that started cold because the scene changed.",
    "frames_with_missing_views": "Results with missing views.",
    "frames_over_budget": "Results that exceeded the time budget.",
    "frames_beyond_range": "Results with at least 1 % of the pixels at one end of the disparity range.",
    "frames_out_of_step": "Results whose time stamps differ by more than the tolerance.",
    "callback_errors": "Exceptions of the callback.",
}


class Counters:
    """Counts and times of a stream; may be used from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = dict.fromkeys(_HELP, 0)
        self._latencies: deque[float] = deque(maxlen=_KEPT)
        self._work: deque[float] = deque(maxlen=_KEPT)
        self._ends: deque[float] = deque(maxlen=_KEPT)

    def add(self, *names: str) -> None:
        """Increment counters."""
        with self._lock:
            for name in names:
                self._counts[name] += 1

    def done(self, latency: float, work: float, *names: str) -> None:
        """Record a result: its latency since `push` and its device time, in seconds, and further counters."""
        with self._lock:
            for name in ("frames_done", *names):
                self._counts[name] += 1
            self._latencies.append(latency)
            self._work.append(work)
            self._ends.append(perf_counter())

    def stats(self) -> dict[str, Any]:
        """Return all statistics as plain numbers."""
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
    """Format statistics as text for Prometheus (version 0.0.4)."""
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
    """Compute percentiles over the latest frames, milliseconds; NaN if there is none."""
    values = np.percentile(seconds * 1000, (50, 95, 99)) if len(seconds) else np.full(3, np.nan)
    return {f"{name}_p{quantile}_ms": float(value) for quantile, value in zip((50, 95, 99), values, strict=True)}


def _rate(ends: list[float]) -> float:
    """Count the results per second over the last seconds; 0 if there were none."""
    now = perf_counter()
    recent = [end for end in ends if now - end <= _RECENT]
    if len(recent) < 2:
        recent = ends[-2:]
        if len(recent) < 2 or now - recent[-1] > max(_RECENT, 2 * (recent[-1] - recent[0])):
            return 0.0
    return (len(recent) - 1) / max(recent[-1] - recent[0], 1e-9)
