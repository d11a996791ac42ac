"""Tables on a terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from lfgpu.cli.console import output

Columns = Mapping[str, str | Callable[[Any], str]]
"""By the title of a column: a format of the names in a row, or a function that writes the cell of a row."""

NONE = "–"
_WIDEST = 240  # columns where the output goes to a file: nobody wraps it there


@dataclass(frozen=True)
class Table:
    """Text in rows; the first `labels` columns are words, the others numbers."""

    title: str
    columns: tuple[str, ...]
    labels: int
    rows: Sequence[tuple[str, ...]]

    @classmethod
    def of(cls, title: str, labels: int, rows: Iterable[Any], columns: Columns) -> Table:
        """Make a table of any rows; formats are for dictionaries."""
        cells = [cell.format_map if isinstance(cell, str) else cell for cell in columns.values()]
        return cls(title, tuple(columns), labels, [tuple(cell(row) for cell in cells) for row in rows])

    def show(self) -> None:
        """Print it, if it has rows."""
        if self.rows:
            shown = RichTable(
                box=SIMPLE_HEAD, title=Text(self.title, style="bold"), title_justify="left", pad_edge=False
            )
            for place, column in enumerate(self.columns):
                is_label = place < self.labels
                shown.add_column(column, justify="left" if is_label else "right", no_wrap=not is_label)
            for row in self.rows:
                shown.add_row(*row)
            console().print(shown)

    @property
    def markdown(self) -> str:
        """The table without its title as Markdown."""
        rule = ["---" if place < self.labels else "---:" for place in range(len(self.columns))]
        return "\n".join(f"| {' | '.join(row)} |" for row in (self.columns, rule, *self.rows))


def console() -> Console:
    """Return a console that prints text as it is, and wide where the output goes to a file."""
    found = output()
    if not found.is_terminal:
        found.width = _WIDEST
    return found


def duration(seconds: float) -> str:
    """Write a time with three digits and a unit."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 0.9995:
            return f"{_digits(seconds * factor)} {unit}"
    return f"{_digits(seconds * 1e6)} µs"


def _digits(number: float) -> str:
    return f"{number:.3g}" if number < 999.5 else f"{number:.0f}"
