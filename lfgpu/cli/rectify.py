"""`lfgpu rectify`: cameras as they are become parallel and alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Computing, OutFolder, Quiet
from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from rich.console import Console

    from lfgpu.calibration import Rectified
    from lfgpu.data import LightField


def rectify(
    source: Annotated[
        Path, typer.Argument(metavar="INPUT", help="A folder of pictures with a calibration, or a light field.")
    ],
    out: OutFolder,
    *,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="cameras.toml, OpenCV or Kalibr (YAML, JSON), COLMAP (its folder), poses_bounds.npy, transforms.json, "
            "models.json, depthai.",
            show_default="what lies beside the pictures",
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(metavar="UNIT", help="Unit of the lengths in the calibration: mm, cm or m.", show_default="m"),
    ] = None,
    refine: Annotated[bool, typer.Option("--refine", help="Also correct the cameras by what the views show.")] = False,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Corrections by --refine: shift, similarity or homography.",
            show_default="similarity",
        ),
    ] = None,
    positions: Annotated[
        bool, typer.Option("--positions", help="Also correct the positions of the cameras, by --refine.")
    ] = False,
    equalise: Annotated[
        bool, typer.Option("--equalise", help="Give all views the brightness of the reference; --refine does so, too.")
    ] = False,
    depths: Annotated[
        str | None,
        typer.Option(
            metavar="NEAR,FAR",
            help="Nearest and farthest depth of the scene, in the unit of the calibration.",
            show_default="from the calibration",
        ),
    ] = None,
    points: Annotated[
        bool,
        typer.Option(
            "--points",
            help="Also estimate a map; write points.ply and original_depth.pfm (depth in the reference as taken).",
        ),
    ] = False,
    computing: Computing,
    quiet: Quiet = False,
) -> None:
    """Make cameras parallel and alike: undo lenses and rotations, line views up, equalise their brightness.

    The output is a light field with masks, which every command reads (lightfield.toml). rectified.npz holds the
    numbers that lead back to the original pictures. For a light field that is read with options, such as --grid,
    give the description that `lfgpu info --write` writes.
    """
    from lfgpu import calibration as cameras
    from lfgpu.calibration.rectify import DEPTH_FILE, POINTS_FILE, calibration_beside
    from lfgpu.cli.console import output
    from lfgpu.io import check_writable, read, save, write_pfm
    from lfgpu.io.views import before_writing

    check_writable(out, source=source if source.is_dir() else source.parent)
    for option, is_given in (("--model", model is not None), ("--positions", positions)):
        if is_given and not refine:
            raise LightFieldError(f"{option} is for --refine; give both or neither.")
    estimation = computing.estimation(values.configured(None, ()))
    for name in (POINTS_FILE, DEPTH_FILE) if points else ():
        check_writable(out / name, folder=False)
    with before_writing(sorted(out.glob("view_[0-9][0-9][0-9].png"))):
        pictures: Path | LightField = source
        if points and calibration is None and calibration_beside(source) is None:
            pictures = read(source, allow_missing=True)
            if pictures.geometry is None:
                raise LightFieldError("--points needs a calibration: without one there is no metric depth.")
        result = cameras.rectify(
            pictures,
            calibration=calibration,
            unit=unit,
            model=("similarity" if model is None else model) if refine else None,
            positions=positions,
            tones=equalise,
            depths=values.parse_range("--depths", depths),
            disparity_range=estimation.disparity_range,
            backend=estimation.backend,
            device=estimation.device,
        )
    cloud = None
    if points:
        cloud = replace(estimation, disparity_range=result.disparity_range).run(result.light_field, quiet=quiet)
    cameras.write_rectified(result, out)
    if cloud is not None:
        save(cloud, out / POINTS_FILE, image=result.light_field.image(result.light_field.reference_index))
        if result.rig is not None:
            write_pfm(out / DEPTH_FILE, result.original_depth(cloud))
    if not quiet:
        _show(output(), result, out, points=points)


def _show(console: Console, result: Rectified, out: Path, *, points: bool) -> None:
    from lfgpu.calibration.rectify import DEPTH_FILE, POINTS_FILE
    from lfgpu.cli import console as shown, summary
    from lfgpu.reports import facts

    lf, rig, found = result.light_field, result.rig, result.refinement
    shown.heading(console, lf.name)
    rows = [("views", facts.views(lf)), ("size", facts.size(lf)), ("reference", facts.reference(lf))]
    if rig is not None:
        rows += [("offsets", facts.offsets(lf)), ("geometry", facts.geometry(lf.geometry))]
    if lf.valid is not None:
        rows.append(("valid", f"{100 * float(lf.valid.mean()):.1f} % of the pixels"))
    if found is not None:
        rows.append(("refined", found.status))
    rows += [("note", note) for note in lf.notes]
    shown.lines(console, rows)
    files = [
        ("lightfield.toml", "views, positions, masks, geometry; every command reads the folder"),
        ("rectified.npz", "the numbers to go back to the original pictures"),
    ]
    if points:
        files.append((POINTS_FILE, "coloured points of the reference view's map"))
        if rig is not None:
            files.append((DEPTH_FILE, "depth in the original picture of the reference camera, NaN where unknown"))
    summary.show_outputs(console, out, files)
