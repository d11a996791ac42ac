"""`lfgpu info`: the way a light field is read, and faults that all its cameras share."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli.options import Reading, Source


def info(
    source: Source,
    *,
    reading: Reading,
    write: Annotated[
        Path | None,
        typer.Option(
            "--write",
            metavar="FILE",
            help="Write a description (.toml or .json) that can be edited and read as a light field.",
        ),
    ] = None,
) -> None:
    """Show how a light field is read: format, grid, views, cameras, ground truth. Missing views are no error here.

    It also tells if the views show nothing, or if the cameras do not fit together (see lfgpu check).
    """
    from lfgpu._backends import DEFAULT, open_device
    from lfgpu.cli.console import heading, lines, output, waiting
    from lfgpu.io import inside, read, write_description
    from lfgpu.io.formats import chosen_format
    from lfgpu.pipelines.verdict import views_alone
    from lfgpu.reports import facts

    options = reading.options()
    chosen, reason = chosen_format(source, reading.format_name, reading.names)
    name = chosen.name
    console = output()
    held = inside(source, format=name)
    if held.no_depth is not None:
        heading(console, source.resolve().stem)
        lines(console, [("format", f"{name}, {reason}"), *held.facts, ("no depth", held.no_depth)])
        return
    with waiting(f"reading {source.name}"):
        lf = read(source, **{**options, "format": name}, allow_missing=True)
        doubts, remarks = views_alone(lf, open_device(DEFAULT, "cpu"))
    if write is not None:
        write_description(lf, write, source={"path": source, **options, "format": name})
    heading(console, lf.name)
    lines(
        console,
        [
            ("format", f"{name}, {reason}"),
            *facts.rows(lf),
            *held.facts,
            *(("note", note) for note in (*lf.notes, *doubts)),
            *(("cameras", sentence) for sentence in remarks),
            *((("written", str(write)),) if write is not None else ()),
        ],
    )
