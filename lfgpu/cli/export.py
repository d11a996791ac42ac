"""`lfgpu export`: the estimate as files that a C++ program runs without Python."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Cold, DisparityRange, OutFolder, Parameters, ReadingIncomplete, preset_option
from lfgpu.printable import printable


@dataclass(frozen=True)
class _Parameters(Parameters):
    """Options that choose the parameters of a method that can be exported."""

    usual = "accurate"

    preset: Annotated[str | None, preset_option(": {recordable presets}", "accurate")] = None


def export(
    source: Annotated[
        Path,
        typer.Argument(metavar="INPUT", help="Light field with the same cameras and size as those to be estimated."),
    ],
    out: OutFolder,
    *,
    parameters: _Parameters,
    disparity_range: DisparityRange = None,
    device: Annotated[str, typer.Option(metavar="DEVICE", help="cpu, cuda or cuda:1.")] = "cpu",
    cold: Cold = False,
    rectify: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Output of `lfgpu rectify` for these cameras. INPUT and all frames are raw pictures, which the C++ "
            "program rectifies.",
        ),
    ] = None,
    reading: ReadingIncomplete,
) -> None:
    """Write the estimate for light fields like INPUT as files, and a C++ program that runs them without Python."""
    from lfgpu.calibration import read_rectifier
    from lfgpu.io import check_writable, read
    from lfgpu.methods.temporal_prior import TemporalPrior
    from lfgpu.pipelines.export import export_pipeline

    check_writable(out, source=source)
    config = parameters.config()
    bounds = values.parse_range("--disparity-range", disparity_range)
    options = reading.options()
    prior = None if cold else TemporalPrior()
    rectifier = None if rectify is None else read_rectifier(rectify)
    lf = read(source, **options)
    if rectifier is not None:
        lf = rectifier.pictures(lf.views, white=lf.white)
    export_pipeline(lf, out, config=config, disparity_range=bounds, device=device, prior=prior, rectifier=rectifier)
    typer.echo(
        printable(f"Wrote the pipeline and its C++ library to {out}; README.txt there says how to build and run it.")
    )
