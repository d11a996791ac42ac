"""Options that several commands share, and files that grow with each row."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from benchmarks.results import write_json
from lfgpu._backends import list_backends, open_device
from lfgpu.contract import Device
from lfgpu.errors import BackendError
from lfgpu.io.atomic import check_writable

DATA = Path(os.environ.get("LFGPU_DATA") or Path(__file__).parents[2] / "shared" / "data")

DeviceName = Annotated[str | None, typer.Option(metavar="DEVICE", help="cpu or cuda:0; default: the best there is.")]
Out = Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="File of the results.")]
Data = Annotated[
    Path,
    typer.Option(metavar="FOLDER", show_default=False, help="Real light fields; default: $LFGPU_DATA, ../shared/data."),
]
Files = Annotated[list[Path], typer.Argument(metavar="FILE.json...", help="Files of `--out`; several are merged.")]
Scenes = Annotated[
    list[str],
    typer.Argument(metavar="SCENE...", help="Folders of light fields with truth, or scenes as boxes-11, NAME-SEED."),
]
Cases = Annotated[str, typer.Option("--cases", metavar="NAME,...", help="ROWSxCOLUMNSxHEIGHTxWIDTH.")]
CaseName = Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")]
Preset = Annotated[str, typer.Option(metavar="NAME")]
Presets = Annotated[str, typer.Option(metavar="NAME,...")]
Backends = Annotated[str, typer.Option(metavar="NAME,...")]
Seconds = Annotated[float, typer.Option(min=0.01, help="For each measurement, at most.")]


def _multiple_of_32(side: int) -> int:
    if side % 32:
        raise typer.BadParameter(f"it must be a multiple of 32, not {side}.")
    return side


Side = Annotated[
    int, typer.Option(min=32, callback=_multiple_of_32, help="Height of the light fields, pixels: a multiple of 32.")
]

Row = dict[str, Any]
"""A measurement, as it stands in a file."""


def listed(text: str) -> list[str]:
    """Return the names of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def known_backend(name: str) -> str:
    """Return the name; BenchmarkError if there is no such backend."""
    check_known([name], "backend", list_backends())
    return name


def places(backends: Iterable[str], device: str | None) -> Iterator[Device]:
    """Yield the device of each backend, by default its best one; say which backends do not have it."""
    for name in map(known_backend, backends):
        try:
            yield open_device(name, device)
        except BackendError as error:
            say(f"{name}: {error}")


def check_known(names: Iterable[str], kind: str, known: Collection[str]) -> None:
    """Raise a BenchmarkError with the first name that is not among those known."""
    if unknown := [name for name in names if name not in known]:
        raise BenchmarkError(f"unknown {kind} {unknown[0]!r}; there are {', '.join(known)}.")


def check_out(*paths: Path | None) -> None:
    """Raise a LfgpuError if a file cannot be written there, so that nothing is measured in vain."""
    for path in paths:
        if path is not None:
            check_writable(path, folder=False)


def say(what: str) -> None:
    """Print a step of a long run on stderr."""
    typer.echo(what, err=True)


def save(out: Path | None, content: dict[str, Any]) -> None:
    """Write a result file, if one is wanted."""
    if out is not None:
        write_json(out, content)


def collected(
    rows: Iterable[Row],
    out: Path | None,
    *,
    benchmark: str,
    about: dict[str, Any] | None = None,
    before: Sequence[Row] = (),
) -> list[Row]:
    """Return all rows, and write the file anew after each of them: an interrupted run leaves what it has.

    The file says which benchmark it comes from, where it was made, and what `about` says, and has the rows `before`
    these.
    """
    check_out(out)
    found, origin = list[Row](), {**machine.about(benchmark), **(about or {})}
    for row in rows:
        found.append(row)
        save(out, {**origin, "rows": [*before, *found]})
    return found
