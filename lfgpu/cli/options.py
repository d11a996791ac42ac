"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
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

OutFolder = Annotated[
    Path, typer.Option("-o", "--out", metavar="FOLDER", help="Where the outputs go; made if missing.")
]

Preset = Annotated[str, typer.Option("--preset", metavar="NAME", help="Parameters to start from. {presets}.")]

ReferenceView = Annotated[
    str | None,
    typer.Option(
        "--reference-view", metavar="ROW,COL", help="View to estimate, counted from 0.", show_default="the centre"
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
        help="Bounds in pixels per view step, larger is nearer.",
        show_default="found",
    ),
]

Backend = Annotated[str, typer.Option("--backend", metavar="NAME", help="Kernels: {backends}.")]

Deterministic = Annotated[
    bool,
    typer.Option("--deterministic", help="Refuse backends whose maps differ from run to run by their last bits."),
]

Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="STAGE.PARAMETER=VALUE",
        help="Change one parameter; may be repeated. `lfgpu parameters` lists them.",
    ),
]

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing unless something goes wrong.")]

Device = Annotated[
    str | None,
    typer.Option("--device", metavar="DEVICE", help="cpu, cuda or cuda:1.", show_default="the best there is"),
]

Source = Annotated[Path, typer.Argument(metavar="INPUT", help="The light field, as a rule a folder of views.")]

FormatName = Annotated[
    str | None,
    typer.Option("--format", metavar="NAME", help="Format of the input: {formats}.", show_default="recognised"),
]

AllowMissing = Annotated[bool, typer.Option("--allow-missing", help="Accept a grid that lost some views.")]
