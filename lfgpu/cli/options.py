"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Threads = Annotated[
    int | None,
    typer.Option("--threads", metavar="N", help="Largest number of CPU threads.", show_default="one per core"),
]

Grid = Annotated[
    str | None,
    typer.Option(
        "--grid",
        metavar="ROWSxCOLUMNS",
        help="Rows and columns of the grid of views.",
        show_default="found from the input",
    ),
]
Every = Annotated[
    int | None,
    typer.Option("--every", metavar="N", help="Use every N-th image or frame as a view.", show_default="all"),
]
Flip = Annotated[
    str,
    typer.Option("--flip", metavar="AXES", help="Reverse the order of the columns (u), the rows (v) or both (uv)."),
]

OutFolder = Annotated[
    Path, typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the outputs; created if missing.")
]

Preset = Annotated[str, typer.Option("--preset", metavar="NAME", help="Parameters to start from. {presets}.")]

ReferenceView = Annotated[
    str | None,
    typer.Option(
        "--reference-view",
        metavar="ROW,COL",
        help="Reference view: the view to estimate, counted from 0.",
        show_default="the centre",
    ),
]

Pattern = Annotated[
    str, typer.Option("--views", metavar="PATTERN", help="Views to use: full, star, cross, row or column.")
]

DisparityRange = Annotated[
    str | None,
    typer.Option(
        "--disparity-range",
        metavar="LOW,HIGH",
        help="Smallest and largest disparity, pixels per view step; larger is nearer.",
        show_default="found",
    ),
]

Backend = Annotated[str, typer.Option("--backend", metavar="NAME", help="Backend that computes: {backends}.")]

Deterministic = Annotated[
    bool,
    typer.Option("--deterministic", help="Refuse backends whose results are not bit-identical from run to run."),
]

Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="STAGE.PARAMETER=VALUE",
        help="Change one parameter; may be repeated. `lfgpu parameters` lists them.",
    ),
]

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]

Device = Annotated[
    str | None,
    typer.Option("--device", metavar="DEVICE", help="cpu, cuda or cuda:1.", show_default="the first GPU, else the CPU"),
]

Source = Annotated[Path, typer.Argument(metavar="INPUT", help="Light field: usually a folder of views.")]

FormatName = Annotated[
    str | None,
    typer.Option("--format", metavar="NAME", help="Format of the input: {formats}.", show_default="recognised"),
]

AllowMissing = Annotated[bool, typer.Option("--allow-missing", help="Accept a grid with missing views.")]
