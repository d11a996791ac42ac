"""Time against the size of the light field: a panel for each operation, a line for each backend and device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.cases import find
from benchmarks.errors import BenchmarkError
from benchmarks.merge import places
from benchmarks.results import Record, Run
from lfgpu.io.atomic import atomic_write

_PANELS = (
    ("operation", "data_term", "data term and gradient"),
    ("operation", "nlm_laplacian", "non-local-means Laplacian"),
    ("pipeline", "paper", "whole method, from scratch"),
    ("pipeline", "resident", "whole method, resident"),
)
# A backend is a colour of Okabe and Ito's, told apart with any colour vision, and a marker; a device is a style.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS = ("o", "s", "^", "D", "v", "P")
_STYLES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (10, 3)))
_LIMIT = {"color": "0.45", "linewidth": 0.9}
_SUFFIXES = (".png", ".svg", ".pdf")
_FEW = 100  # where the longest time is below so many shortest ones, ticks at 2 and 5 are needed


@dataclass
class Line:
    """What one backend took on one device of one machine."""

    backend: str
    place: str
    records: list[Record] = field(default_factory=list)


def write(runs: Sequence[Run], path: Path) -> None:
    """Draw merged runs; the suffix of `path` is the format. BenchmarkError if it is none that can be drawn."""
    if path.suffix.lower() not in _SUFFIXES:
        raise BenchmarkError(f"{path.name} must end in {', '.join(_SUFFIXES)}.")
    figure = draw(runs)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=150)


def draw(runs: Sequence[Run]) -> Figure:
    """The figure; BenchmarkError if there is nothing to draw."""
    panels = [(title, lines) for kind, name, title in _PANELS if (lines := _lines(runs, kind, name))]
    if not panels:
        raise BenchmarkError("nothing to draw: no data term, Laplacian or whole method was measured.")
    figure = Figure(figsize=(1 + 3.9 * len(panels), 5.2), layout="constrained")
    drawn = [line for _, lines in panels for line in lines]
    backends = list(dict.fromkeys(line.backend for line in drawn))
    devices = list(dict.fromkeys(line.place for line in drawn))
    for place, (title, lines) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), place + 1)
        for line in lines:
            _draw_line(axes, line, backends.index(line.backend), _style(devices, line.place))
        for device in devices:
            _draw_limit(axes, [line for line in lines if line.place == device], _style(devices, device))
        _finish(axes, title, lines)
    figure.axes[0].set_ylabel("time of one call")
    handles = [
        *(Line2D([], [], color=_colour(i), marker=_marker(i), label=backend) for i, backend in enumerate(backends)),
        *(Line2D([], [], color="black", linestyle=_style(devices, device), label=device) for device in devices),
    ]
    if any(record.limit for line in drawn for record in line.records):
        handles.append(Line2D([], [], **_LIMIT, label="limit of the device's memory"))  # type: ignore[arg-type]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4), frameon=False)
    return figure


def _draw_line(axes: Axes, line: Line, backend: int, style: Any) -> None:
    """Medians, with bars from quartile to quartile."""
    x, medians, below, above = [], [], [], []
    for r in sorted(line.records, key=_samples):
        assert r.seconds is not None
        x.append(_samples(r))
        medians.append(r.seconds.median)
        below.append(r.seconds.median - r.seconds.q1)
        above.append(r.seconds.q3 - r.seconds.median)
    look = {"color": _colour(backend), "marker": _marker(backend), "markersize": 5, "linestyle": style}
    axes.errorbar(x, medians, yerr=(below, above), capsize=3, elinewidth=0.9, **look)


def _draw_limit(axes: Axes, lines: list[Line], style: Any) -> None:
    limits = {_samples(r): r.limit for line in lines for r in line.records if r.limit is not None}
    if limits:
        x = sorted(limits)
        axes.plot(x, [limits[samples] for samples in x], linestyle=style, **_LIMIT)  # type: ignore[arg-type]


def _finish(axes: Axes, title: str, lines: list[Line]) -> None:
    sizes = {_samples(r): r.case.replace("x", "×") for line in lines for r in line.records}
    axes.set_title(title, fontsize=11)
    axes.set_xscale("log")
    axes.set_xticks(list(sizes), list(sizes.values()), rotation=40, ha="right", rotation_mode="anchor")
    axes.set_xticks([], minor=True)
    axes.set_xlabel("light field, by views × pixels")
    axes.set_yscale("log")
    bottom, top = axes.get_ylim()
    if top < _FEW * bottom:
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(_tick)
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", color="0.9")
    axes.set_axisbelow(True)


def _lines(runs: Sequence[Run], kind: str, name: str) -> list[Line]:
    found: dict[tuple[str, str], Line] = {}
    for run, place in zip(runs, places(runs), strict=True):
        for r in run.records:
            if (r.kind, r.name) == (kind, name) and r.seconds is not None:
                key = r.backend, place(r.device)
                found.setdefault(key, Line(*key)).records.append(r)
    return list(found.values())


def _samples(record: Record) -> int:
    return find(record.case).samples


def _colour(backend: int) -> str:
    return _COLOURS[backend % len(_COLOURS)]


def _marker(backend: int) -> str:
    return _MARKERS[backend % len(_MARKERS)]


def _style(devices: list[str], device: str) -> Any:
    return _STYLES[devices.index(device) % len(_STYLES)]


def _tick(seconds: float, _: float) -> str:
    for factor, unit in ((1, "s"), (1e3, "ms")):
        if seconds * factor >= 0.999:
            return f"{seconds * factor:g} {unit}"
    return f"{seconds * 1e6:g} µs"
