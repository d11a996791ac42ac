"""`lfgpu info`: what a light field is taken for, before anything is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def info(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="The light field, as a rule a folder of views.")],
    format_name: Annotated[
        str | None, typer.Option("--format", metavar="NAME", help="Format of INPUT.", show_default="recognised")
    ] = None,
) -> None:
    """Show what the files are taken for: grid, views, cameras, ground truth. Missing views are reported, no error."""
    from lfgpu.cli import facts
    from lfgpu.cli.console import heading, lines, output
    from lfgpu.io import read, recognise

    lf = read(source, format=format_name, allow_missing=True)
    if format_name is None:
        chosen, reason = recognise(source)
        taken_for = f"{chosen.name}, because {reason}"
    else:
        taken_for = f"{format_name}, as told"
    console = output()
    heading(console, lf.name)
    lines(
        console,
        [
            ("format", taken_for),
            ("views", facts.views(lf)),
            *((("missing", facts.missing(lf)),) if lf.missing else ()),
            ("size", facts.size(lf)),
            ("reference", facts.reference(lf)),
            ("offsets", facts.offsets(lf)),
            ("geometry", facts.geometry(lf.geometry)),
            ("ground truth", facts.truth(lf)),
            *(("note", note) for note in lf.notes),
        ],
    )
