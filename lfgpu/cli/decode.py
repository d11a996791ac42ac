"""`lfgpu decode`: the views of a raw capture of a lenslet camera, as image files."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli.options import OutFolder


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
    """Make views of a raw capture of a lenslet camera: 16-bit PNG files that all commands read, and the grid found."""
    from lfgpu.cli.console import heading, lines, output, waiting
    from lfgpu.cli.summary import show_outputs
    from lfgpu.io import check_writable
    from lfgpu.io.formats import check_exists
    from lfgpu.io.lenslet.decode import ABOUT_FILE, decode as decode_capture, write_decoded
    from lfgpu.reports import facts

    check_writable(out)
    check_exists(source, "a raw capture")
    if white is not None:
        check_exists(white, "a white image")
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
    show_outputs(
        console,
        out,
        [
            ("view_row_col.png", "views: 16 bits, square roots of linear values"),
            (ABOUT_FILE, "grid of microlenses, colours and value range"),
        ],
    )
