"""`lfgpu export`: the estimate as files that a C++ program runs without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import AllowMissing, DisparityRange, Every, Flip, FormatName, Grid, Parameters


def export(
    source: Annotated[
        Path,
        typer.Argument(metavar="INPUT", help="Light field with the same cameras and size as those to be estimated."),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the files; created if missing.")
    ],
    preset: Annotated[
        str, typer.Option(metavar="NAME", help="Parameters to start from: {recordable presets}.")
    ] = "accurate",
    disparity_range: DisparityRange = None,
    device: Annotated[str, typer.Option(metavar="DEVICE", help="cpu, cuda or cuda:1.")] = "cpu",
    cold: Annotated[
        bool, typer.Option("--cold", help="Estimate each frame independently, without the temporal prior.")
    ] = False,
    rectify: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Output of `lfgpu rectify` for these cameras. INPUT and all frames are raw pictures, which the C++ "
            "program rectifies.",
        ),
    ] = None,
    settings: Parameters = None,
    format_name: FormatName = None,
    grid: Grid = None,
    every: Every = None,
    flip: Flip = "",
    allow_missing: AllowMissing = False,
) -> None:
    """Write the estimate for light fields like INPUT as files, and a C++ program that runs them without Python."""
    from lfgpu.calibration import read_rectifier
    from lfgpu.io import check_writable, read
    from lfgpu.methods.temporal_prior import TemporalPrior
    from lfgpu.pipelines.export import export_pipeline

    check_writable(out)
    config = values.configured(preset, settings or ())
    bounds = values.parse_disparity_range(disparity_range)
    reading = values.reading(format_name, grid, every, flip, allow_missing=allow_missing)
    prior = None if cold else TemporalPrior()
    lf = read(source, **reading)
    rectifier = None if rectify is None else read_rectifier(rectify)
    if rectifier is not None:
        lf = rectifier.pictures(lf.views, white=lf.white)
    export_pipeline(lf, out, config=config, disparity_range=bounds, device=device, prior=prior, rectifier=rectifier)
    typer.echo(f"Wrote the pipeline and its C++ library to {out}; README.txt there says how to build and run it.")
