"""Where results go: a file, the terminal, and a line on stderr for each step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import typer

from benchmarks import live, results, show
from benchmarks.errors import BenchmarkError
from lfgpu.io.atomic import check_writable

Row = TypeVar("Row")


def check_out(*paths: Path | None) -> None:
    """LfgpuError if a file cannot be written there; so that nothing is measured in vain."""
    for path in paths:
        if path is not None:
            check_writable(path, folder=False)


def collected(
    rows: Iterable[Row],
    out: Path | None,
    about: dict[str, Any],
    *,
    key: str = "rows",
    as_json: Callable[[Any], dict[str, Any]] = asdict,
    before: Sequence[Row] = (),
) -> list[Row]:
    """All rows. After each, the file has those before and all up to it: what is interrupted is kept as far as it is."""
    found: list[Row] = []
    for row in rows:
        found.append(row)
        live.save(out, {**about, key: [as_json(one) for one in (*before, *found)]})
    return found


def finish(run: results.Run, out: Path | None) -> None:
    """Save and show a run; BenchmarkError if there is nothing in it."""
    if out is not None:
        results.save(run, out)
    show.terminal(run)
    if not any(record.seconds for record in run.records):
        raise BenchmarkError("nothing could be measured, see above.")


def say(what: str) -> None:
    typer.echo(what, err=True)
