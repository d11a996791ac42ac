"""Times of calls that may return before the device is done.

No operation waits for a device, but reading a number back cannot return before what was asked for earlier is done, at
least where work is done in the order in which it was asked for, as every backend here does. That is the stop of the
clock. On a GPU it costs tens of microseconds, more than a small operation, and a method asks for many operations
between two looks at a result. So calls are timed in batches with one stop at the end of each, as many calls as it takes
for the stop to be a small part; what a call costs is the batch over their number.

Where a backend can give its device work as a whole, a batch is made of such pieces of many calls each, as the method
does it too: what Python takes to ask for an operation is then not in its time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import perf_counter

import numpy as np

from benchmarks.results import Spread
from lfgpu.contract import Device

_SHORTEST_BATCH = 0.02  # seconds, so that the clock and the scheduler do not matter
_STOP_SHARE = 0.02  # of a batch at most
_MOST_CALLS = 100_000
_MOST_CAPTURED = 64  # calls in one piece of work

Work = Callable[[], None]
Capture = Callable[[Work], Work | None]


@dataclass(frozen=True)
class Timed:
    """Seconds of one call, how many were made between two stops, and seconds of a stop on an idle device."""

    seconds: Spread
    calls: int
    stop: float
    captured: bool
    """True if the device was given many calls as one piece of work."""


def stopper(device: Device) -> Callable[[], object]:
    """Make a function that waits until the device is done."""
    number = device.scalar(0.0)
    return lambda: device.kernels.number(number)


def measure_on(device: Device, call: Work, *, repeats: int, budget: float) -> Timed:
    """Time work of a device as `measure` does, many calls as one piece of work where it takes such."""
    capture = partial(device.kernels.capture, device=device.name)
    return measure(call, stopper(device), repeats=repeats, budget=budget, capture=capture)


def measure(
    call: Work, stop: Callable[[], object], *, repeats: int, budget: float, capture: Capture | None = None
) -> Timed:
    """Time `call` in `repeats` batches, at least 3, but no more than fit into `budget` seconds.

    The calls that find the size of a batch warm up.
    """
    for _ in range(2):
        call()
        stop()
    stops = median(_batch(lambda: None, stop, 1) for _ in range(9))
    shortest = max(_SHORTEST_BATCH, stops / _STOP_SHARE)
    unit, in_unit = _captured(call, stop, shortest, capture) if capture else (None, 1)
    work = unit or call
    units = 1
    while (taken := _batch(work, stop, units)) < shortest and units < _MOST_CALLS:
        units = min(_MOST_CALLS, max(2 * units, int(units * shortest / taken) + 1))
    each: list[float] = []
    end = perf_counter() + budget
    while len(each) < min(3, repeats) or (len(each) < repeats and perf_counter() < end):
        each.append(_batch(work, stop, units) / (units * in_unit))
    return Timed(spread(each), units * in_unit, stops, unit is not None)


def singly(call: Callable[[], object], *, least: int, most: int, budget: float) -> list[float]:
    """Time calls that wait for the device themselves: `most` or as many as fit into `budget`, but at least `least`."""
    seconds: list[float] = []
    end = perf_counter() + budget
    while len(seconds) < least or (len(seconds) < most and perf_counter() < end):
        start = perf_counter()
        call()
        seconds.append(perf_counter() - start)
    return seconds


def spread(seconds: list[float]) -> Spread:
    """Compute median, quartiles and 99 % quantile."""
    q1, middle, q3, p99 = (float(q) for q in np.quantile(seconds, (0.25, 0.5, 0.75, 0.99)))
    return Spread(middle, q1, q3, len(seconds), p99)


def _captured(call: Work, stop: Callable[[], object], shortest: float, capture: Capture) -> tuple[Work | None, int]:
    """Capture many calls as one piece of work, with their number; (None, 1) where there is no such thing.

    They are an even number, since an operation may go to and fro.
    """
    count = min(_MOST_CAPTURED, 2 * math.ceil(shortest / _batch(call, stop, 2)))

    def calls() -> None:
        for _ in range(count):
            call()

    unit = capture(calls)
    return unit, 1 if unit is None else count


def _batch(call: Work, stop: Callable[[], object], calls: int) -> float:
    start = perf_counter()
    for _ in range(calls):
        call()
    stop()
    return perf_counter() - start
