"""`lfgpu decode`: the views of a raw capture of a lenslet camera, as image files."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli.options import OutFolder
from lfgpu.errors import LightFieldError


def decode(
    source: Annotated[
        Path, typer.Argument(metavar="RAW", help="Raw capture: .lfp, .lfr, .raw, or a grey image of the sensor.")
    ],
    out: OutFolder,
    white: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="White image, taken with the same camera and zoom.", show_default="the capture itself"
        ),
    ] = None,
    bayer: Annotated[
        str | None,
        typer.Option(
            metavar="PATTERN", help="Colour filter of the sensor: bggr, grbg, gbrg, rggb or grey.", show_default="found"
        ),
    ] = None,
    views: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Rows and columns of views.", show_default="as many as pixels under a microlens"
        ),
    ] = None,
) -> None:
    """Make views of a raw capture of a lenslet camera: 16-bit PNG files that all commands read, and the lattice found.

    Of a processed Lytro container, what it holds is written: views, refocused pictures, Lytro's own depth.
    """
    from lfgpu.cli.console import heading, lines, output, waiting
    from lfgpu.io import check_writable, lytro
    from lfgpu.io.formats import check_exists
    from lfgpu.io.lenslet.decode import decode as decode_capture
    from lfgpu.io.lenslet.written import ABOUT_FILE, write_decoded
    from lfgpu.reports import facts

    check_writable(out)
    check_exists(source, "a raw capture")
    if white is not None:
        check_exists(white, "a white image")
    if lytro.recognise(source) is not None:
        if white is not None or bayer is not None or views is not None:
            raise LightFieldError(f"{source} has no raw picture; leave --white, --bayer and --views out.")
        _extract(source, out)
        return
    with waiting(f"reading {source.name}") as say:
        decoded = decode_capture(source, bayer=bayer, white=white, views=views, progress=say)
        say("writing the views")
        write_decoded(decoded, out)
    lf = decoded.light_field
    console = output()
    heading(console, lf.name)
    lines(
        console,
        [
            ("found", decoded.about["found"]),
            ("views", facts.views(lf)),
            ("size", facts.size(lf)),
            ("colours", decoded.about["bayer"]),
            *(("note", note) for note in lf.notes),
        ],
    )
    heading(console, f"Written to {out}")
    lines(
        console,
        [
            ("view_row_col.png", "views: 16 bits, square roots of linear values"),
            (ABOUT_FILE, "grid of microlenses, colours and value range"),
        ],
    )


def _extract(source: Path, out: Path) -> None:
    """Write what a processed container holds."""
    from lfgpu.cli.console import heading, lines, output, waiting
    from lfgpu.io import lytro
    from lfgpu.io.lytro.reader import write_contents

    held = lytro.inside(source)
    with waiting(f"reading {source.name}"):
        written = write_contents(source, out)
    console = output()
    heading(console, source.resolve().stem)
    lines(console, [*held.facts, *((("no depth", held.no_depth),) if held.no_depth else ())])
    heading(console, f"Written to {out}")
    lines(console, written)
