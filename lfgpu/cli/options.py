"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

Threads = Annotated[
    int | None,
    typer.Option("--threads", metavar="N", help="Threads of the CPU to use at most.", show_default="one for each core"),
]
