"""The amounts of work that a stream may do for a frame: from one step of the alignment to all that is asked for.

With a budget the largest that fits is taken, by the time that the device took for it before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

from lfgpu.contract import Device, Transport

_SMOOTHING = 0.1  # weight of the latest frame in the mean time of a level


@dataclass
class Level:
    """One amount of work for a frame, prepared: steps of the alignment, what does them, and seconds of the device."""

    steps: int
    work: Callable[[], None]
    seconds: float = 0.0

    def took(self, seconds: float) -> None:
        """A frame took so long."""
        self.seconds += _SMOOTHING * (seconds - self.seconds)


def prepared(
    works: Sequence[tuple[int, Callable[[], None]]],
    budget_ms: float | None,
    transport: Transport,
    device: Device,
) -> list[Level]:
    """Levels of (steps, work), from least to most, captured and timed; without a budget only the largest, not timed."""
    levels = [Level(steps, work) for steps, work in works]
    if budget_ms is None:
        levels = levels[-1:]
    for level in levels:
        with device.asking():
            level.work()
        level.work = transport.captured(level.work)
    for level in levels if budget_ms is not None else ():
        transport.synchronize()
        start = perf_counter()
        level.work()
        transport.synchronize()
        level.seconds = perf_counter() - start
    return levels


def fitting(levels: Sequence[Level], budget_ms: float | None) -> Level:
    """The largest level that fits into the budget, or the least of all."""
    found = [level for level in levels if budget_ms is None or level.seconds * 1000 <= budget_ms]
    return found[-1] if found else levels[0]
