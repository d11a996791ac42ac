"""`lfgpu convert`: a disparity map in another file format."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.cli import values
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable


def convert(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="A folder that `lfgpu depth` wrote, a file in it, or another map.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="FILE", help="Output; its suffix is the format: .pfm .png .tif .exr .npz .ply."
        ),
    ],
    view: Annotated[
        str | None,
        typer.Option(
            metavar="ROW,COL", help="View whose map is taken from maps of all views.", show_default="the reference view"
        ),
    ] = None,
    colours: Annotated[
        Path | None,
        typer.Option("--image", metavar="INPUT", help="Light field that gives the colours of a point cloud."),
    ] = None,
) -> None:
    """Write a disparity map in another format, or as a point cloud, with its metadata."""
    from lfgpu.data import ViewsResult
    from lfgpu.io import RESULT_FILE, check_no_inputs, check_writable, load, one_map, read, save, writable_format
    from lfgpu.io.description import named_by

    check_writable(out, folder=False, source=result / RESULT_FILE if result.is_dir() else result)
    writable_format(out)
    place = values.parse_place("--view", view)
    whole = load(result)
    if place is not None and not isinstance(whole, ViewsResult):
        raise LightFieldError(
            f"--view chooses from the maps of all views, but {result} holds a single map; leave --view out, or give a "
            "disparities.npz."
        )
    found, image = one_map(whole, None if place is None else place[::-1]), None
    if colours is not None:
        lf = read(colours, allow_missing=True)
        check_no_inputs([out], (*lf.files, *named_by(colours)))
        if found.position is None:
            raise LightFieldError(
                f"{result} does not say which view it belongs to, so --image cannot colour its points; leave --image "
                "out."
            )
        u, v = found.position
        image = lf.view(v, u)
    save(found, out, image=image)
    typer.echo(printable(f"Wrote {out}."))
