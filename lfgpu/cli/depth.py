"""`lfgpu depth`: a disparity map of a light field, with confidence and depth, as a folder of files."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from lfgpu._backends import DEFAULT
from lfgpu.cli.options import Computing, Deterministic, OutFolder, Parameters, Quiet, ReadingIncomplete, Source, Views
from lfgpu.errors import LightFieldError
from lfgpu.threads import meanwhile

if TYPE_CHECKING:
    from pathlib import Path

    from lfgpu.cameras import Explanation
    from lfgpu.cli.options import Estimation
    from lfgpu.data import DepthResult, LightField

_JUDGED = 40_000_000  # pixels of all views: of larger light fields a report does not say how well they are predicted


def depth(
    ctx: typer.Context,
    source: Source,
    out: OutFolder,
    *,
    parameters: Parameters,
    chosen: Views,
    all_views: Annotated[bool, typer.Option("--all-views", help="Also write consistent maps of all views.")] = False,
    saved: Annotated[
        list[str] | None,
        typer.Option(
            "--save",
            metavar="FILE",
            help="Also write the map to FILE in FOLDER, as .exr, .tif, .png, .pfm or .npz, or as a point cloud .ply; "
            "may be repeated.",
        ),
    ] = None,
    fill: Annotated[
        bool, typer.Option("--fill", help="Fill pixels that are not known (masked, NaN) from the farther side.")
    ] = False,
    computing: Computing,
    deterministic: Deterministic = False,
    max_memory: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Memory limit, such as 8GiB; larger light fields are estimated in tiles.",
            show_default="what is free",
        ),
    ] = None,
    reading: ReadingIncomplete,
    report: Annotated[
        bool,
        typer.Option(
            "--report",
            help="Also write report.html: input, maps, scores, what the map predicts, and parameters on one page.",
        ),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the disparity of one view, or of all views, and metric depth if the cameras are known.

    Writes maps (.pfm), pictures (.png) and a result.npz with everything; --all-views adds disparities.npz. These
    files of an earlier run are replaced or removed, others in FOLDER stay. If anything fails, no file is written.
    """
    from lfgpu.cli import summary
    from lfgpu.cli.console import output, remark
    from lfgpu.cli.outputs import NAMES, check_names, write_outputs, write_saved, write_view_maps
    from lfgpu.data.filling import fill_unknown, filled
    from lfgpu.io import RESULT_FILE, atomic_folder, check_no_inputs, check_writable, read
    from lfgpu.io.description import named_by
    from lfgpu.io.views import before_writing
    from lfgpu.methods.footprint import parse_memory
    from lfgpu.pipelines.verdict import needed_views

    check_names("--save", saved or ())
    for place in (out, *(out / name for name in saved or ())):
        check_writable(place, folder=place == out, source=source)
    config = parameters.config()
    estimation = computing.estimation(config, check=False, deterministic=deterministic, max_memory=max_memory)
    if max_memory is not None:
        parse_memory(max_memory)
        if all_views:
            raise LightFieldError(
                "--max-memory works for the map of one view only; leave out --max-memory or --all-views."
            )
    options = reading.options()
    if chosen.place() is None and not all_views and not report:
        options["needed"] = needed_views(config, chosen.pattern)
    if computing.device is not None or computing.backend != DEFAULT:
        estimation.check_device()  # what was asked for is checked before anything is read

    outputs = [out / name for name in (*NAMES, *(saved or ()))]
    check_no_inputs(outputs, named_by(source))
    with meanwhile(estimation.prepare), before_writing(outputs):  # imports go on while threads decode files
        lf = read(source, lazy=max_memory is not None, **options)
    lf = chosen.of(lf)
    views = estimation.run_all(lf, quiet=quiet) if all_views else None
    result = views.reference if views else estimation.run(lf, quiet=quiet)
    if fill:
        result = filled(result)
    if views:
        disparities = fill_unknown(views.disparities) if fill else views.disparities
        views = replace(views, disparities=disparities, reference=result)
    with atomic_folder(out, ours=NAMES, mark=RESULT_FILE) as folder:
        files = write_outputs(folder, result)
        if views:
            files += write_view_maps(folder, views)
        if report:
            files.append(_write_report(folder, ctx, source, lf, result, estimation))
        files += write_saved(folder, saved or (), result, lf.image(lf.reference_index))
    if quiet:
        return
    console = output()
    summary.show_input(console, lf)
    summary.show_result(console, result, range_given=estimation.disparity_range is not None)
    for note in result.notes:
        remark(console, note)
    summary.show_scores(console, lf, result)
    summary.show_remarks(console, result.remarks)
    summary.show_outputs(console, out, files)
    summary.show_next(console, ("lfgpu", "view", source, out, *reading.words()))


def _write_report(
    folder: Path, ctx: typer.Context, source: Path, lf: LightField, result: DepthResult, estimation: Estimation
) -> tuple[str, str]:
    """Write the report; returns the file as a pair (name, meaning)."""
    from lfgpu.cli.failures import command_line
    from lfgpu.reports.report import REPORT_FILE, Origin, write_report

    origin = Origin.now(source, command_line(ctx), result.device)
    write_report(folder / REPORT_FILE, lf, result, origin=origin, explanation=_explanation(lf, result, estimation))
    return REPORT_FILE, "everything on one page, for any browser"


def _explanation(lf: LightField, result: DepthResult, estimation: Estimation) -> Explanation | None:
    """Explain the map by `lfgpu.explain`; None where it says nothing, or the light field would take minutes."""
    from lfgpu.cameras import explain

    if lf.views[..., 0].size > _JUDGED:
        return None
    try:
        return explain(lf, result, backend=estimation.backend, device=estimation.device)
    except LightFieldError:
        return None
