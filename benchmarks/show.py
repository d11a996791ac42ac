"""Tables on a terminal and as Markdown."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from benchmarks.results import Run
from benchmarks.tables import Table, doubts, headings, remarks, tables

_WIDEST = 240  # columns where the output goes to a file: nobody wraps it there


def terminal(run: Run) -> None:
    """Print a run."""
    console = _console()
    for line in headings(run):
        console.print(line)
    for table in tables(run.records):
        console.print(_rich(table))
    for line in remarks(run):
        console.print(f"not measured: {line}")
    for line in doubts(run):
        console.print(f"wrong: {line}")


def table(found: Table) -> None:
    """Print one table, if it has rows."""
    if found.rows:
        _console().print(_rich(found))


def markdown(run: Run) -> str:
    """A run as a section of a README."""
    parts = [f"### {run.where}", *headings(run)[1:]]
    parts += [f"**{table.title}**\n\n{markdown_table(table)}" for table in tables(run.records)]
    for heading, lines in (("Not measured", remarks(run)), ("Wrong", doubts(run))):
        if lines:
            parts.append(f"{heading}:\n\n" + "\n".join(f"- {line}" for line in lines))
    return "\n\n".join(parts) + "\n"


def _console() -> Console:
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = _WIDEST
    return console


def _rich(table: Table) -> RichTable:
    shown = RichTable(box=SIMPLE_HEAD, title=Text(table.title, style="bold"), title_justify="left", pad_edge=False)
    for place, column in enumerate(table.columns):
        shown.add_column(column, justify="left" if place < table.labels else "right", no_wrap=place >= table.labels)
    for row in table.rows:
        shown.add_row(*row)
    return shown


def markdown_table(table: Table) -> str:
    """A table as Markdown."""
    rule = ["---" if place < table.labels else "---:" for place in range(len(table.columns))]
    return "\n".join(f"| {' | '.join(row)} |" for row in (table.columns, rule, *table.rows))
