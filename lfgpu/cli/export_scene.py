"""`lfgpu export-scene`: a light field with its depth for COLMAP, nerfstudio and Gaussian splatting."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Computing, OutFolder, Preset, Quiet, ReadingIncomplete, Source


def export_scene(
    source: Source,
    out: OutFolder,
    *,
    maps: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT",
            help="Output of `lfgpu depth`. If that ran without --all-views, only one view has depth.",
            show_default="maps of all views are estimated first",
        ),
    ] = None,
    preset: Preset = "surest",
    computing: Computing,
    reading: ReadingIncomplete,
    quiet: Quiet = False,
) -> None:
    """Write cameras, depth maps of the views and a coloured point cloud as COLMAP and nerfstudio read them.

    The light field must have a geometry, which says where its cameras are.
    """
    from lfgpu import calibration
    from lfgpu.calibration.export import check_scene
    from lfgpu.cli import summary
    from lfgpu.cli.console import output
    from lfgpu.io import VIEWS_FILE, check_writable, load, read

    check_writable(out, source=source)
    options = reading.options()
    estimation = computing.estimation(values.configured(preset, ()))
    lf = read(source, **options)
    check_scene(lf, out)
    if maps is None:
        found = estimation.run_all(lf, quiet=quiet)
    else:
        found = load(maps / VIEWS_FILE if (maps / VIEWS_FILE).exists() else maps)  # type: ignore[assignment]
    notes = calibration.export_scene(lf, found, out)
    if not quiet:
        files = [
            ("transforms.json", "nerfstudio: cameras and files of all views"),
            ("sparse/0/", "COLMAP: cameras, images, points, binary and as text"),
            ("images/, depths/", "the views; their depth in whole units, 0 where unknown"),
            ("stereo/depth_maps/", "COLMAP: depth in metres, 0 where unknown"),
            ("points.ply", "coloured points, to begin Gaussian splatting with"),
        ]
        summary.show_outputs(output(), out, [*files, *(("note", note) for note in notes)])
