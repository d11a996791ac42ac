"""`lfgpu scene`: a synthetic light field with exact ground truth, as an HCI folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lfgpu.cli import values
from lfgpu.cli.options import OutFolder
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lfgpu.data import LightField

_FRAME = "frame_"


def scene(
    name: Annotated[
        str, typer.Argument(help="relief, planes, boxes, bars, textureless, moving or still_life.", show_default=False)
    ],
    out: OutFolder,
    seed: Annotated[int, typer.Option(help="Seed of positions, colours, textures and noise.")] = 0,
    grid: Annotated[str, typer.Option(metavar="ROWSxCOLUMNS", help="Grid of views.")] = "9x9",
    size: Annotated[str, typer.Option(metavar="HEIGHTxWIDTH", help="Size of each view, pixels.")] = "512x512",
    disparity_range: Annotated[
        str,
        typer.Option(
            metavar="FAR,NEAR", help="Smallest and largest true disparity, pixels per view step; larger is nearer."
        ),
    ] = "-1.5,1.5",
    noise: Annotated[float, typer.Option(help="Standard deviation of the noise, intensities 0 to 1.")] = 0.0,
    misalign: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=SIGMA,...",
            help="Cameras as they are: shift (px), roll (degrees), scale, distortion, position (view steps), gain, "
            "offset, vignetting, noise. Also writes cameras.toml, as a checkerboard would say, and cameras_true.toml.",
            show_default=False,
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(help="Number of frames of the scene moving; each frame gets its own folder.", show_default=False),
    ] = None,
) -> None:
    """Make a synthetic light field with exact ground truth, in the format of the HCI 4D Light Field Benchmark."""
    from lfgpu.io import check_writable, write_hci
    from lfgpu.scenes import make, sequence

    check_writable(out)
    options: dict[str, Any] = {
        "seed": seed,
        "grid": values.parse_size("--grid", grid, "ROWSxCOLUMNS such as 9x9"),
        "size": values.parse_size("--size", size, "HEIGHTxWIDTH such as 512x512"),
        "disparity_range": values.parse_range("--disparity-range", disparity_range),
        "noise": noise,
    }
    if misalign is not None:
        if frames is not None:
            raise LightFieldError("--misalign is for one light field; leave it or --frames out.")
        _write_misaligned(name, misalign, options, out)
        typer.echo(printable(f"Wrote {name}, misaligned, with its exact disparity and two calibrations to {out}."))
    elif frames is None:
        write_hci(make(name, **options), out)
        typer.echo(printable(f"Wrote {name} with its exact disparity to {out}."))
    else:
        _write_frames(sequence(name, frames=frames, **options), out)
        typer.echo(
            printable(f"Wrote {frames} frames of {name} with their exact disparities to {out}/{_FRAME}000 and so on.")
        )


def _write_frames(light_fields: Iterator[LightField], out: Path) -> None:
    """Write all frames or none. A folder that already holds frames is refused, as old and new frames would mix."""
    from lfgpu.io import atomic_folder, write_hci

    if any(out.glob(f"{_FRAME}*")):
        raise LightFieldError(f"{out} already holds frames of a sequence; choose an empty folder.")
    with atomic_folder(out) as place:
        for index, frame in enumerate(light_fields):
            write_hci(frame, place / f"{_FRAME}{index:03d}")


def _write_misaligned(name: str, misalign: str, options: dict[str, Any], out: Path) -> None:
    from dataclasses import replace

    from lfgpu.calibration.formats import write_cameras
    from lfgpu.calibration.misalign import Misalignment, displacements, disturb
    from lfgpu.io import atomic_folder, write_hci
    from lfgpu.scenes import make

    how = Misalignment.parse(misalign)
    rows, columns = options["grid"]
    reference = rows // 2 * columns + columns // 2
    moved = displacements(rows * columns, reference, how.position, options["seed"])
    found = disturb(make(name, displaced=moved, **options), how, seed=options["seed"], moved=moved)
    with atomic_folder(out) as place:
        write_hci(found.light_field, place)
        for file, cameras in (("cameras.toml", found.calibrated), ("cameras_true.toml", found.cameras)):
            named = [replace(camera, name=f"input_Cam{n:03d}.png") for n, camera in enumerate(cameras)]
            write_cameras(named, place / file)
