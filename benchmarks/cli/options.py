"""Options that several commands share, and what their texts stand for."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.errors import BenchmarkError
from lfgpu._backends import list_backends

Device = Annotated[str | None, typer.Option(metavar="DEVICE", help="cpu or cuda:0; default: the best there is.")]
Out = Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")]
Data = Annotated[
    Path, typer.Option(metavar="FOLDER", help="The real light fields; default: $LFGPU_DATA, or ../shared/data.")
]
Files = Annotated[list[Path], typer.Argument(metavar="FILE.json...", help="What `--out` wrote; several are merged.")]
Scenes = Annotated[
    list[str],
    typer.Argument(metavar="SCENE...", help="Folders of light fields with truth, or scenes as boxes-11, NAME-SEED."),
]
CaseNames = Annotated[str, typer.Option("--cases", metavar="NAME,...")]
CaseSize = Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")]
Presets = Annotated[str, typer.Option(metavar="NAME,...")]
Backends = Annotated[str, typer.Option(metavar="NAME,...", help="Default: warp.")]
Seconds = Annotated[float, typer.Option(min=0.01, help="For each measurement, at most.")]


def listed(text: str) -> list[str]:
    """The names of a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def known_backend(name: str) -> str:
    """The name; BenchmarkError if there is no such backend."""
    if name not in list_backends():
        raise BenchmarkError(f"unknown backend {name!r}; there are {', '.join(list_backends())}.")
    return name


def check_known(names: Iterable[str], kind: str, known: Collection[str]) -> None:
    """BenchmarkError with the first name that is not among those known."""
    if unknown := [name for name in names if name not in known]:
        raise BenchmarkError(f"unknown {kind} {unknown[0]!r}; there are {', '.join(known)}.")
