"""Output of commands: labelled lines, tables and a progress display."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from lfgpu.printable import printable

if TYPE_CHECKING:
    from lfgpu.comparison import Table as Compared
    from lfgpu.config import Config
    from lfgpu.methods.base import Stage
    from lfgpu.metrics import Metrics, Sparsification

Progress = Callable[[str, int, float], None]
"""Called as progress(stage, iteration, value), as `estimate_depth` does."""

_LABELS = 13  # characters: the width of labels, so that several blocks are aligned
_NARROWEST = 100  # columns at least where the output is not a terminal
_RUNNERS = {"keys": "key views", "join": "all views", "tiles": "tiles"}  # stages of pipelines, beside the method's
_SHARE = "share"  # the value that these report


class _Shown(Console):
    """A terminal that obeys nothing that stands in texts: names of files may hold escape sequences."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Return the segments of something, with what is not printable in their texts written out."""
        for segment in super().render(renderable, options):
            safe = segment.control or segment.text.isprintable()
            yield segment if safe else Segment(printable(segment.text, keep="\n"), segment.style)


def output() -> Console:
    """Return the console that the answer of a command goes to."""
    console = _Shown(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = max(console.width, _NARROWEST)
    return console


def heading(console: Console, text: str) -> None:
    """Print an empty line, then a line in bold."""
    console.print()
    console.print(Text(text, style="bold"))


def lines(console: Console, facts: Sequence[tuple[str, str]]) -> None:
    """Print labelled texts; a long text continues in its own column."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(min_width=_LABELS, no_wrap=True, style="cyan")
    grid.add_column(overflow="fold")
    for label, text in facts:
        grid.add_row(label, text)
    _print(console, grid)


def _table() -> Table:
    return Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1), header_style="cyan")


def _print(console: Console, what: RenderableType) -> None:
    """Print something below a heading."""
    console.print(Padding(what, (0, 0, 0, 2), expand=False))


def scores(console: Console, rows: Mapping[str, Metrics]) -> None:
    """Print the metrics of the HCI 4D benchmark, a row for each map; the table fits into 80 columns."""
    table = _table()
    table.add_column("")
    for name in ("MSE\nx100", "BadPix\n0.07", "BadPix\n0.03", "BadPix\n0.01", "Q25\nx100", "RMSE", "un-\ndefined"):
        table.add_column(name, justify="right", no_wrap=True)
    for name, m in rows.items():
        table.add_row(
            name,
            f"{m.mse_100:.3f}",
            *(f"{share:.2f} %" for share in (m.badpix_07, m.badpix_03, m.badpix_01)),
            f"{m.q25:.3f}",
            f"{m.rmse:.4f}",
            f"{m.undefined:.2f} %",
        )
    _print(console, table)


def region_scores(console: Console, rows: Mapping[str, Mapping[str, float]]) -> None:
    """Print the benchmark's measures of regions from top to bottom, maps from left to right."""
    from lfgpu.metrics import REGION_METRICS

    table = _table()
    table.add_column("")
    for name in rows:
        table.add_column(Text(name), justify="right")
    for metric in REGION_METRICS:
        values = [scores[metric.name] for scores in rows.values() if metric.name in scores]
        if values:
            table.add_row(f"{metric.name} ({metric.unit})", *(f"{value:.2f}" for value in values))
    _print(console, table)


def comparison(console: Console, scored: Compared) -> None:
    """Print a table with a row per scene and method and a column per metric; the best of each scene is bold."""
    from lfgpu.comparison import COLUMNS

    table = _table()
    table.add_column("scene")
    table.add_column("method")
    for metric in COLUMNS:
        table.add_column(metric.replace(" ", "\n"), justify="right", no_wrap=True)
    for scene, rows in scored.scenes.items():
        for row in rows:
            cells = [Text(cell, style="bold" if best else "") for cell, best in zip(row.cells, row.best, strict=True)]
            table.add_row(Text(scene if row is rows[0] else ""), Text(row.method), *cells)
        table.add_section()
    _print(console, table)


def sparsification(console: Console, curve: Sparsification) -> None:
    """Print how well the confidence tells which pixels are bad."""
    if math.isnan(curve.ause):
        remark(console, "No pixel is bad, so the confidence cannot be judged.")
        return
    half = list(curve.kept).index(50)
    remark(
        console,
        f"By the confidence, {curve.bad[half]:.2f} % of the surest half of the pixels are bad (BadPix "
        f"{curve.threshold:g}); {curve.oracle[half]:.2f} % is possible. The area between both curves is "
        f"{curve.ause:.3f} (AUSE, 0 is best).",
    )


def backend_rows(console: Console, rows: Sequence[tuple[str, str, Sequence[str]]]) -> None:
    """Print a row for each backend: its name, the installed package, and its devices or why it cannot run."""
    table = _table()
    table.add_column("backend", no_wrap=True)
    table.add_column("needs", no_wrap=True)
    table.add_column("runs on", overflow="fold")
    for name, installed, where in rows:
        table.add_row(name, installed, "\n".join(where))
    console.print(table)


def remark(console: Console, text: str) -> None:
    """Print a sentence below a heading."""
    _print(console, Text(text))


@contextmanager
def waiting(text: str = "", *, quiet: bool = False, counts: bool = False) -> Iterator[Callable[..., None]]:
    """Show on stderr what is going on and for how long while the block runs; nothing where it is no terminal.

    Yields what takes another text and, where they are known, how many are done and of how many; with `counts` these
    are shown as numbers, with the time that is left.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress as Display,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True, highlight=False, markup=False)
    console.quiet = quiet or not console.is_terminal  # rich 13 ends a display that is disabled with an empty line
    columns = (
        SpinnerColumn("line"),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        *((MofNCompleteColumn(), TextColumn("left"), TimeRemainingColumn()) if counts else ()),
        TextColumn("{task.description}", markup=False, table_column=Column(ratio=1)),  # what room is left
    )
    with Display(*columns, console=console, transient=True, expand=True, disable=console.quiet) as display:
        task = display.add_task(text, total=None)

        def show(now: str, done: int = 0, total: int | None = None) -> None:
            display.tasks[0].total = total
            display.update(task, description=now, completed=done)

        yield show


@contextmanager
def progress(config: Config, *, quiet: bool) -> Iterator[Progress]:
    """Show the stage, its iterations and their value on stderr while the block runs, if stderr is a terminal."""
    from lfgpu.methods import method_of

    method = method_of(config)
    stages = {stage.name: stage for stage in method.stages}
    with waiting("range and noise; the first run compiles kernels", quiet=quiet) as say:

        def show(stage: str, iteration: int, value: float) -> None:
            label = stages[stage].label if stage in stages else _RUNNERS[stage]
            state = f", iteration {iteration}, {_said(stages.get(stage), value)}" if iteration > 0 else ""
            say(f"{label}{state}", iteration, method.iterations(stage))

        yield show


def _said(stage: Stage | None, value: float) -> str:
    """Return the value of a stage after an iteration, with its name and unit."""
    if stage is None or stage.value is None:
        return f"{_SHARE} {value:.6g}"
    return f"{stage.value} {value:.6g} {stage.unit or ''}".rstrip()
