"""Statistics of a stream: counts and times."""

import threading
from collections import deque
from time import perf_counter
from typing import Any

import numpy as np

_KEPT = 1024  # latest frames whose times are kept
_RECENT = 2.0  # seconds over which the frame rate is averaged

_COUNTED = (
    "frames_pushed",  # frames given to the stream
    "frames_done",  # frames with a result
    "frames_dropped",  # frames dropped because they came too fast or the stream was closed
    "frames_failed",  # frames that failed
    "frames_cold",  # results that did not start from the previous map
    "scene_cuts",  # frames that started cold because the scene changed
    "frames_with_missing_views",  # results with missing views
    "frames_over_budget",  # results that exceeded the time budget
    "frames_beyond_range",  # results with at least 1 % of the pixels at one end of the disparity range
    "frames_out_of_step",  # results whose time stamps differ by more than the tolerance
    "callback_errors",  # exceptions of the callback
)
"""Counts of frames."""


class Counters:
    """Counts and times of a stream; may be used from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = dict.fromkeys(_COUNTED, 0)
        self._times: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)  # latency, work and end of each result

    def add(self, *names: str) -> None:
        """Increment counters."""
        with self._lock:
            for name in names:
                self._counts[name] += 1

    def done(self, latency: float, work: float, *names: str) -> None:
        """Record a result: its latency since `push` and its device time, in seconds, and further counters."""
        self.add("frames_done", *names)
        with self._lock:
            self._times.append((latency, work, perf_counter()))

    def stats(self) -> dict[str, Any]:
        """Return all statistics as plain numbers."""
        with self._lock:
            counts, times = dict(self._counts), list(self._times)
        latencies, work, ends = np.reshape(times, (-1, 3)).T
        in_work = counts["frames_pushed"] - sum(counts[f"frames_{end}"] for end in ("done", "dropped", "failed"))
        return {
            **counts,
            "frames_in_work": in_work,
            "frames_per_second": _rate(ends.tolist()),
            **_percentiles("latency", latencies),
            **_percentiles("work", work),
        }


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
