"""Where the time of a frame goes: each operation of a stream against what memory and arithmetic of the device allow.

The operations of one cold and one warm frame are noted while a plan runs, with their arrays. Then all calls of one
operation are timed together, as one piece of work where the device takes one. The limit of an operation is the longer
of two times: that of its bytes (each array that a call is given, once) at the bandwidth of a copy of long vectors, and
that of its floating point operations, where they are counted, at the rate of long chains of multiply-adds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks import clock
from benchmarks.moving import RANGE, Film
from lfgpu import TemporalPrior
from lfgpu._backends import load, pick_device
from lfgpu.contract import SMOOTHING_REACH
from lfgpu.methods import method_of

_PLANNED = {"plane_sweep", "z_buffer", "alignment", "nlm_weights", "motion"}  # operations that return what is called
_NOT_WORK = {"field", "image", "zeros", "zeros_image", "scalar", "number", "numpy", "upload", "repeat", "capture"}
_BUDGET, _REPEATS = 1.0, 15
_LENGTH = 1 << 25  # elements of the vectors that are copied
_CHAINS, _CHAIN = 1 << 20, 512  # threads, and multiply-adds of each

# Floating point operations for each sample that an operation looks at; samples are counted below.
_SWEEP, _AVERAGE, _RATIO, _PLANE, _PATHS, _ALIGN, _WEIGHTS, _MOTION, _SMOOTH = 24, 2, 8, 20, 8, 40, 24, 120, 19
_INTENSITIES = 10  # of a sweep without gradients


@dataclass(frozen=True)
class Row:
    """One operation of one kind of frame: calls, and seconds of all of them.

    `memory` and `arithmetic` are the seconds that its bytes and its counted operations take at the device's rates; the
    latter is 0 where operations are not counted.
    """

    case: str
    preset: str
    warm: bool
    operation: str
    calls: int
    seconds: float
    bytes: float
    operations: float
    memory: float
    arithmetic: float
    captured: bool

    @property
    def limit(self) -> float:
        """Seconds that it takes at least."""
        return max(self.memory, self.arithmetic)


@dataclass(frozen=True)
class Rates:
    """Bytes and floating point operations per second, measured."""

    bandwidth: float
    arithmetic: float


@dataclass(frozen=True)
class _Call:
    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: dict[str, Any]

    def __call__(self) -> None:
        self.function(*self.arguments, **self.options)

    @property
    def bytes(self) -> int:
        given = [value for value in (*self.arguments, *self.options.values()) if isinstance(value, wp.array)]
        return sum(array.size * wp.types.type_size_in_bytes(array.dtype) for array in given)


class _Watched:
    """A backend, or what it planned, that notes each call."""

    def __init__(self, target: Any, log: list[_Call], name: str = "") -> None:
        self._target, self._log, self._name = target, log, name

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._target, name)
        return self._noting(value, name) if callable(value) else value

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self._noting(self._target, "")(*arguments, **options)

    def _noting(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            result = function(*arguments, **options)
            if name in _PLANNED:
                return _Watched(result, self._log, name)
            if name not in _NOT_WORK:
                full = ".".join(filter(None, (self._name, name)))
                self._log.append(_Call(full, function, arguments, options))
            return result

        return call


def rates(device: str | None) -> Rates:
    """What the device does at best: a copy of long vectors, and chains of multiply-adds."""
    kernels = load()
    device = pick_device(kernels, device)
    stop, capture = clock.stopper(kernels, device), clock.capturer(kernels, device)
    x, y = (kernels.zeros((_LENGTH // 8192, 8192), device) for _ in range(2))
    kernels.fill(1.0, x)
    copy = clock.measure(lambda: kernels.copy(x, y), stop, repeats=_REPEATS, budget=_BUDGET, capture=capture)
    chains = kernels.zeros((_CHAINS,), device)
    wp.load_module(_chain_kernel.module, device=device)

    def chain() -> None:
        wp.launch(_chain_kernel, _CHAINS, [chains], device=device)

    multiply = clock.measure(chain, stop, repeats=_REPEATS, budget=_BUDGET, capture=capture)
    return Rates(8 * _LENGTH / copy.seconds.median, 2 * _CHAINS * _CHAIN * 4 / multiply.seconds.median)


def run(
    case: str, film: Film, presets: tuple[str, ...], device: str | None, found: Rates, say: Callable[[str], None]
) -> Iterator[Row]:
    """Measure all operations of the presets on one case, on a device of those rates."""
    kernels = load()
    device = pick_device(kernels, device)
    say(f"{case}: casting a frame")
    lf = film.frames()[0]
    for preset in presets:
        say(f"{case} {preset}: operations")
        log: list[_Call] = []
        watched: Any = _Watched(kernels, log)
        method = method_of(preset)
        used = lf.subset(method.used_views(lf.layout))
        measured = method.measure(lf, kernels, device, disparity_range=RANGE)
        streaming: Any = _Watched(kernels.streaming, log)
        plan = method.live_plan(used.layout, measured, watched, device, streaming=streaming, prior=TemporalPrior())
        views = kernels.image(used.views, device)
        for warm, work in ((False, plan.levels[-1][1]), (True, plan.warm_levels[-1][1])):
            work(views)
            log.clear()
            work(views)
            calls = list(log)
            for name in dict.fromkeys(call.name for call in calls):
                some = [call for call in calls if call.name == name]
                yield _measured(case, preset, warm, name, some, kernels, device, found)


def _measured(
    case: str, preset: str, warm: bool, name: str, calls: list[_Call], kernels: Any, device: str, found: Rates
) -> Row:
    def work() -> None:
        for call in calls:
            call()

    stop, capture = clock.stopper(kernels, device), clock.capturer(kernels, device)
    timed = clock.measure(work, stop, repeats=_REPEATS, budget=_BUDGET, capture=capture)
    size = float(sum(call.bytes for call in calls))
    count = float(sum(_operations(call) for call in calls))
    return Row(
        case,
        preset,
        warm,
        name,
        len(calls),
        timed.seconds.median,
        size,
        count,
        size / found.bandwidth,
        count / found.arithmetic,
        timed.captured,
    )


def _operations(call: _Call) -> float:
    """Floating point operations of a call, about; 0 where they are not counted, because memory is the limit."""
    arrays = [value for value in (*call.arguments, *call.options.values()) if isinstance(value, wp.array)]
    largest = max((array.size for array in arrays), default=0)
    window = call.options.get("window", 1) ** 2
    match call.name:
        case "plane_sweep.by_view_sets" | "plane_sweep.by_visibility":
            views = call.function.__self__._shape  # type: ignore[attr-defined]
            each = _SWEEP if call.options.get("truncation") is None else _INTENSITIES
            return float(each * views[0] * views[3] * largest)
        case "nlm_average":
            return float(_AVERAGE * window * call.options["average_out"].size)
        case "nlm_ratio" | "nlm_neighbors" | "nlm_laplacian":
            return float(_RATIO * window * arrays[-1].size)
        case "nlm_plane":
            return float(_PLANE * window * arrays[-1].size)
        case "semi_global":
            return float(8 * _PATHS * largest)
        case "alignment":
            return float(_ALIGN * largest)
        case "smooth_views":
            return float(_SMOOTH * (2 * SMOOTHING_REACH + 1) ** 2 * largest)
        case "nlm_weights":
            return float(_WEIGHTS * largest)
        case "motion.find":
            return float(_MOTION * largest)
    return 0.0


def show(found: Rates, rows: list[Row]) -> None:
    """A table for each kind of frame, the longest operation first."""
    console = Console(highlight=False)
    console.width = max(console.width, 110)
    kinds = dict.fromkeys((row.case, row.preset, row.warm) for row in rows)
    for case, preset, warm in kinds:
        some = [row for row in rows if (row.case, row.preset, row.warm) == (case, preset, warm)]
        total, limit = sum(row.seconds for row in some), sum(row.limit for row in some)
        table = Table(
            title=f"{case} {preset} {'warm' if warm else 'cold'}: {1e3 * total:.2f} ms, limit {1e3 * limit:.2f}"
        )
        for name in ("operation", "calls", "ms", "MB", "Mflop", "limit, ms", "by", "time / limit"):
            table.add_column(name, no_wrap=True, justify="left" if name in ("operation", "by") else "right")
        for row in sorted(some, key=lambda row: -row.seconds):
            table.add_row(
                row.operation,
                str(row.calls),
                f"{1e3 * row.seconds:.3f}",
                f"{row.bytes / 1e6:.1f}",
                f"{row.operations / 1e6:.1f}" if row.operations else "",
                f"{1e3 * row.limit:.3f}",
                "arithmetic" if row.arithmetic > row.memory else "memory",
                f"{row.seconds / row.limit:.1f}" if row.limit else "",
            )
        console.print(table)
    console.print(f"At {found.bandwidth / 1e9:.0f} GB/s and {found.arithmetic / 1e12:.2f} Tflop/s, both measured.")


@wp.kernel(enable_backward=False)  # type: ignore[untyped-decorator]
def _chain_kernel(values: wp.array(dtype=float)):  # type: ignore[valid-type, no-untyped-def]
    """Four chains side by side, so that none waits for its own result."""
    i = wp.tid()
    start = values[i]
    a = start
    b = start + 1.0
    c = start + 2.0
    d = start + 3.0
    for _ in range(wp.static(_CHAIN)):
        a = a * 0.999 + 0.001
        b = b * 0.998 + 0.002
        c = c * 0.997 + 0.003
        d = d * 0.996 + 0.004
    values[i] = a + b + c + d
