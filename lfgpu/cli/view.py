"""`lfgpu view`: a light field and maps of it in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli.options import Every, Flip, FormatName, Grid, Threads


def view(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="INPUT_OR_RESULT...", help="A light field, and maps or folders that depth wrote."),
    ],
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of 127.0.0.1; the next free one if it is taken, 0 for any.")
    ] = 8080,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    threads: Threads = None,
    format_name: FormatName = None,
    grid: Grid = None,
    every: Every = None,
    flip: Flip = "",
) -> None:
    """Look at a light field, its epipolar plane images, maps and points in space, and estimate again, in the browser.

    Only this machine reaches the page. Maps are compared if there are several. With --format, --grid, --every or
    --flip, the first INPUT_OR_RESULT is read as the light field. Ctrl-C ends it.
    """
    from lfgpu.cli import values
    from lfgpu.viewer import Viewer

    values.use_threads("--threads", threads)
    reading = values.reading(format_name, grid, every, flip)
    with Viewer.of(paths, port=port, **reading) as viewer:
        typer.echo(f"Look at {viewer.url} with a browser of this machine; Ctrl-C ends it.")
        if show:
            webbrowser.open(viewer.url)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            typer.echo("Closed.")
