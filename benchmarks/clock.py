"""Times of calls that may return before the device is done.

The contract has no operation that waits for a device, but `numpy` cannot return before what was asked for earlier is
done, at least where work is done in the order in which it was asked for, as every backend here does. Reading one
number back so is the stop of the clock. On a GPU that costs tens of microseconds, more than a small operation, and a
method asks for many operations between two looks at a result. So calls are timed in batches with one stop at the end
of each, as many calls as it takes for the stop to be a small part; what a call costs is the batch over their number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np

from benchmarks.results import Spread
from lfgpu.types import KernelSet

_SHORTEST_BATCH = 0.02  # seconds, so that the clock and the scheduler do not matter
_STOP_SHARE = 0.02  # of a batch at most
_MOST_CALLS = 100_000


@dataclass(frozen=True)
class Timed:
    """Seconds of one call, how many were made between two stops, and seconds of a stop on an idle device."""

    seconds: Spread
    calls: int
    stop: float


def stopper(kernels: KernelSet, device: str) -> Callable[[], object]:
    """What waits until the device is done."""
    number = kernels.zeros((1,), device)
    return lambda: kernels.numpy(number)


def measure(call: Callable[[], object], stop: Callable[[], object], *, repeats: int, budget: float) -> Timed:
    """Time `call` in `repeats` batches, at least 3, but no more than fit into `budget` seconds.

    The calls that find the size of a batch warm up.
    """
    for _ in range(2):
        call()
        stop()
    stops = median(_batch(lambda: None, stop, 1) for _ in range(9))
    shortest = max(_SHORTEST_BATCH, stops / _STOP_SHARE)
    calls = 1
    while (taken := _batch(call, stop, calls)) < shortest and calls < _MOST_CALLS:
        calls = min(_MOST_CALLS, max(2 * calls, int(calls * shortest / taken) + 1))
    each: list[float] = []
    end = perf_counter() + budget
    while len(each) < min(3, repeats) or (len(each) < repeats and perf_counter() < end):
        each.append(_batch(call, stop, calls) / calls)
    return Timed(spread(each), calls, stops)


def spread(seconds: list[float]) -> Spread:
    """Median and quartiles."""
    q1, middle, q3 = (float(q) for q in np.quantile(seconds, (0.25, 0.5, 0.75)))
    return Spread(middle, q1, q3, len(seconds))


def _batch(call: Callable[[], object], stop: Callable[[], object], calls: int) -> float:
    start = perf_counter()
    for _ in range(calls):
        call()
    stop()
    return perf_counter() - start
