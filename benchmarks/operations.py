"""Times of the operations of an estimate, each beside the time that its bytes take at the device's bandwidth.

The calls of one frame are noted while a plan runs, with their arrays. Then all calls of one operation are timed
together, as one piece of work where the device takes one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import cases, clock
from benchmarks.job import Job
from benchmarks.processes import sentence
from benchmarks.results import Record
from lfgpu import LightField, TemporalPrior
from lfgpu._backends import open_device
from lfgpu.contract import Device
from lfgpu.methods import method_of

RANGE = (-1.6, 1.6)
"""The disparities of the scene with a margin, pixels per view step."""

_CONTROL = {"upload", "repeat", "capture"}
"""Members of a backend that return nothing and are no operation of their own."""

_NOTES = {"residuals.begin", "residuals.add", "lbfgs.begin", "lbfgs.judge"}
"""Notes that solvers make of a few numbers; there is room for those of one run only."""

_BUDGET = 1.0  # seconds for the repeats of one operation


@dataclass(frozen=True)
class _Call:
    name: str
    function: Callable[..., object]
    arguments: tuple[Any, ...]
    options: dict[str, Any]

    def __call__(self) -> None:
        self.function(*self.arguments, **self.options)


class _Noting:
    """A backend, or a plan that it made, whose calls are noted in a log.

    By the contract an operation returns nothing: its output is an argument. Arrays and numbers come from the memory,
    and anything else is a plan, whose calls are operations.
    """

    def __init__(self, target: Any, log: list[_Call], results: tuple[type, ...], name: str = "") -> None:
        self._target, self._log, self._results, self._name = target, log, results, name

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._target, name)
        return self._noted(value, name) if callable(value) else value

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self._noted(self._target, "")(*arguments, **options)

    def _noted(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        full = ".".join(filter(None, (self._name, name)))

        def call(*arguments: Any, **options: Any) -> Any:
            result = function(*arguments, **options)
            if name in _CONTROL or isinstance(result, self._results):
                return result
            if result is None:
                if full not in _NOTES:
                    self._log.append(_Call(full, function, arguments, options))
                return None
            return _Noting(result, self._log, self._results, full)

        return call


def measure(job: Job) -> Iterator[Record]:
    """Time each operation of a frame with a preset; where streams can start from the last map, of such a frame, too."""
    lf, device = cases.load(Path(job.scene)), open_device(job.backend, job.device)
    arrays = type(device.zeros((2, 2))), type(device.scalar(0.0))
    for frame, calls in _frames(job.name, lf, device, arrays):
        for operation in dict.fromkeys(call.name for call in calls):
            some = [call for call in calls if call.name == operation]
            name = f"{frame}: {operation}"
            try:
                timed = clock.measure_on(device, partial(_all, some), repeats=job.repeats, budget=_BUDGET)
            except Exception as error:  # whatever a backend raises: it is listed, and the rest goes on
                yield job.record(name, failed=sentence(error))
                continue
            yield job.record(
                name,
                seconds=timed.seconds,
                calls=timed.calls,
                bytes=sum(_bytes(call, arrays, device) for call in some),
                details={"frame": frame, "operation": operation, "count": len(some), "captured": timed.captured},
            )


def _all(calls: list[_Call]) -> None:
    for call in calls:
        call()


def _frames(preset: str, lf: LightField, device: Device, arrays: tuple[type, ...]) -> Iterator[tuple[str, list[_Call]]]:
    """Run one frame on its own, and one that starts from the map of another; by name, their calls."""
    method, log = method_of(preset), list[_Call]()
    results = (*arrays, np.ndarray, int, float, str, bool, tuple)
    noting: Any = _Noting(device.kernels, log, results)
    watched = Device(noting, device.name)
    measured = method.measure(lf, device, disparity_range=RANGE)
    stages = method.plan(lf.layout, measured, watched).stages(device.image(lf.views))
    log.clear()
    for work in stages.values():
        work(None)
    yield preset, list(log)
    if method.is_live and device.kernels.streaming is not None:
        used = lf.subset(method.used_views(lf.offsets))
        streaming: Any = _Noting(device.kernels.streaming, log, results)
        plan = method.live_plan(used.layout, measured, watched, streaming=streaming, prior=TemporalPrior())
        views = device.image(used.views)
        for levels in (plan.levels, plan.warm_levels):
            log.clear()
            levels[-1][1](views)
        yield f"{preset}, warm", list(log)


def _bytes(call: _Call, arrays: tuple[type, ...], device: Device) -> int:
    """Add up the bytes of the arrays that a call is given, each once."""
    given = {id(value): value for value in (*call.arguments, *call.options.values()) if isinstance(value, arrays)}
    return sum(device.kernels.numpy(value).nbytes for value in given.values())
