"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

Threads = Annotated[
    int | None,
    typer.Option("--threads", metavar="N", help="Threads of the CPU to use at most.", show_default="one for each core"),
]

Grid = Annotated[
    str | None,
    typer.Option("--grid", metavar="ROWSxCOLUMNS", help="How the views stand.", show_default="found, or asked for"),
]
Every = Annotated[
    int | None, typer.Option("--every", metavar="N", help="Take one image or frame of N.", show_default="all")
]
Flip = Annotated[
    str,
    typer.Option("--flip", metavar="AXES", help="Cameras are counted from the right (u), from below (v): u, v, uv."),
]
