"""`lfgpu render`: new views, refocused and all-in-focus images, and videos of them."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Computing, Preset, Quiet, ReadingIncomplete, Source
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable

_SWEEPS = ("circle", "across", "down", "focus")


def render(
    source: Source,
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="FILE", help="Image: .png, .tif. Sweep: .gif, .mp4, or a folder of PNG files."
        ),
    ],
    *,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="ROW,COL",
            help="Render a view at this position, between the recorded views or beyond; counted from 0.",
        ),
    ] = None,
    focus: Annotated[
        float | None, typer.Option("--refocus", metavar="D", help="Refocus on this disparity, pixels per view step.")
    ] = None,
    in_focus: Annotated[
        bool, typer.Option("--all-in-focus", help="Render the reference view from all views, which lowers the noise.")
    ] = False,
    sweep: Annotated[
        str | None, typer.Option(metavar="PATH", help=f"Render a video along a path: {', '.join(_SWEEPS)}.")
    ] = None,
    maps: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT", help="Maps that `lfgpu depth --all-views` wrote.", show_default="estimated first"
        ),
    ] = None,
    reference_view: Annotated[
        str | None,
        typer.Option(
            metavar="ROW,COL",
            help="View that is refocused or rendered all in focus, counted from 0.",
            show_default="the centre",
        ),
    ] = None,
    frames: Annotated[int, typer.Option(min=2, max=10000, help="Number of frames of a sweep.")] = 30,
    fps: Annotated[float, typer.Option(help="Frames per second of a sweep.")] = 15.0,
    preset: Preset = "surest",
    computing: Computing,
    reading: ReadingIncomplete,
    quiet: Quiet = False,
) -> None:
    """Render a new view, a refocused image, an all-in-focus image or a video.

    Give exactly one of --view, --refocus, --all-in-focus and --sweep.
    """
    from lfgpu.cli.rendering import Rendering
    from lfgpu.io import check_no_inputs, check_writable, read
    from lfgpu.io.description import named_by
    from lfgpu.io.frames import check_frames_path, check_image_path, write_frames, write_image
    from lfgpu.methods import method_of

    asked = [view is not None, focus is not None, in_focus, sweep is not None]
    if sum(asked) != 1:
        raise LightFieldError("give one of --view, --refocus, --all-in-focus and --sweep.")
    if sweep is not None and sweep not in _SWEEPS:
        raise LightFieldError(f"--sweep must be one of {', '.join(_SWEEPS)}, not {sweep!r}.")
    if sweep is None:
        check_image_path(out)
    else:
        check_frames_path(out, frames)
    check_writable(out, folder=not out.suffix, source=source)
    place = values.parse_place("--view", view)
    reference = values.parse_place("--reference-view", reference_view)
    options = reading.options()
    estimation = computing.estimation(method_of(preset).for_rendering)

    lf = read(source, **options)
    check_no_inputs([out], (*lf.files, *named_by(source)))
    if reference is not None:
        lf = lf.with_reference(lf.index_of(*reference))
    dtype = "uint16" if lf.views.dtype == "uint16" else "uint8"
    rendering = Rendering(lf, maps, estimation, quiet)
    if sweep is not None:
        write_frames(rendering.film(sweep, frames), out, fps=fps, dtype=dtype)
    else:
        write_image(rendering.picture(place, focus), out, dtype=dtype)
    if not quiet:
        typer.echo(printable(f"Wrote {out}."))
