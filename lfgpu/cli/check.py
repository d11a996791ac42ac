"""`lfgpu check`: how well a map explains its light field, and what is wrong with the cameras."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Computing, Quiet, ReadingIncomplete, ReferenceView, Source

if TYPE_CHECKING:
    from rich.console import Console

    from lfgpu.cameras import Explanation
    from lfgpu.data import LightField


def check(
    source: Source,
    result: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RESULT]",
            help="Output of `lfgpu depth`, or another map of the reference view.",
            show_default="estimated with the preset fast",
        ),
    ] = None,
    *,
    reference_view: ReferenceView = None,
    computing: Computing,
    reading: ReadingIncomplete,
    quiet: Quiet = False,
) -> None:
    """Say what is wrong with the cameras of a light field. No ground truth is needed.

    The reference view and its map predict every other view. The differences show how far each view is shifted, turned
    and scaled, how much brighter it is, and whether the signs of the axes are right.
    """
    from lfgpu.cameras import explain
    from lfgpu.cli.console import output
    from lfgpu.io import load, one_map, read

    place = values.parse_place("--reference-view", reference_view)
    options = reading.options()
    estimation = computing.estimation(values.configured("fast", ()))
    lf = read(source, **options)
    found = None if result is None else one_map(load(result))
    if place is not None:
        lf = lf.with_reference(lf.index_of(*place))
    elif found is not None and found.position is not None:
        lf = lf.with_reference(lf.index_of(found.position[1], found.position[0]))
    judged = found or estimation.run(lf, quiet=quiet, check_cameras=False)
    explanation = explain(lf, judged, backend=estimation.backend, device=estimation.device)
    if not quiet:
        _show(output(), lf, explanation)


def _show(console: Console, lf: LightField, found: Explanation) -> None:
    import numpy as np

    from lfgpu.cli import console as shown
    from lfgpu.reports import facts

    predicted = 100 * float(np.delete(found.predicted, found.reference).mean())
    rows = [
        ("views", facts.views(lf)),
        ("predicted", f"{found.mean_psnr:.1f} dB PSNR over {predicted:.0f} % of the pixels of the other views"),
        ("points", f"{found.points}, with texture, on smooth surfaces"),
    ]
    if np.isfinite(found.misalignment):  # else too few points say anything of cameras
        darkest, brightest = 100 * np.nanmin(found.brightness), 100 * np.nanmax(found.brightness)
        turned, scaled, count = _rms(found.rotation), 100 * _rms(found.scale), len(found.offsets)
        across = " across their line" * (count == 2)
        rows.append(
            ("shifts", f"{found.misalignment:.3f} px rms{across}, standard error {_rms(found.shift_error):.3f} px")
        )
        if np.linalg.matrix_rank(np.column_stack([np.ones(count), found.offsets])) < count:
            rows += [
                ("rotations", f"{turned:.4f} degrees rms, standard error {_rms(found.rotation_error):.4f} degrees"),
                ("scales", f"{scaled:.4f} % rms, standard error {100 * _rms(found.scale_error):.4f} %"),
            ]
        else:
            along = "shifts along their line, " * (count == 2)
            rows.append(("unknown", f"{along}rotations and scales: {count} views cannot tell them from another depth"))
        rows.append(("brightness", f"{darkest:.1f} % to {brightest:.1f} % of the reference"))
    shown.heading(console, lf.name)
    shown.lines(console, rows)
    shown.heading(console, "What stands out")
    shown.lines(
        console, [("finding", sentence) for sentence in found.findings] or [("nothing", "the views fit together.")]
    )


def _rms(numbers: object) -> float:
    import numpy as np

    return float(np.sqrt(np.nanmean(np.asarray(numbers, np.float64) ** 2)))
