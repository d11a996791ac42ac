"""`lfgpu eval`: the error of a disparity map against ground truth."""

from pathlib import Path
from typing import Annotated

import typer

from lfgpu.errors import LightFieldError


def evaluate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT TRUTH | METHOD... | BATCH...",
            help="A map (.pfm, .npz, .tif, .exr, ...) or a folder that `lfgpu depth` wrote, and its ground truth: a "
            "map, or a light field with ground truth. With --scene: folders of results. Or folders that `lfgpu batch` "
            "wrote.",
        ),
    ],
    scenes: Annotated[
        list[Path] | None,
        typer.Option(
            "--scene",
            metavar="TRUTH",
            help="Light field with ground truth on which methods are compared; may be repeated. A METHOD folder holds "
            "its result as NAME/ or NAME.pfm.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the tables and error maps of a comparison."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Image that is not zero at scored pixels.", show_default="the mask of TRUTH"),
    ] = None,
    border: Annotated[
        int | None, typer.Option(help="Width of the border that is left out, pixels.", show_default="15")
    ] = None,
    submission: Annotated[
        Path | None,
        typer.Option(
            "--hci-submission",
            metavar="FOLDER",
            help="Score nothing, and write the files of a submission to the HCI benchmark. Each RESULT is a folder "
            "that `lfgpu depth` wrote, named as its scene.",
        ),
    ] = None,
) -> None:
    """Score a disparity map with the metrics of the HCI 4D Light Field Benchmark; smaller is better.

    Results of `lfgpu depth` also get the share of bad pixels in the more confident half.
    Several methods on several scenes (--scene) give one table; -o writes it as table.md, table.tex and table.csv, the
    error maps as errors.png, and report.html with all of it. Several batches give one table of all items with ground
    truth.
    """
    from lfgpu.cli import scoring

    if submission is not None:
        if scenes or out is not None or mask is not None or border is not None:
            raise LightFieldError(
                "--hci-submission goes with results only; leave --scene, --out, --mask, --border out."
            )
        scoring.submit(paths, submission)
        return
    if scenes:
        if mask is not None:
            raise LightFieldError(
                "--mask does not work with --scene, which uses the masks of the light fields; leave --mask out."
            )
        scoring.compare(paths, scenes, out, border)
        return
    if scoring.are_batches(paths):
        if mask is not None or border is not None:
            raise LightFieldError(
                "--mask and --border do not work with batches, which were scored when they ran; leave them out, or "
                "give --scene."
            )
        scoring.compare_batches(paths, out)
        return
    if len(paths) != 2:
        raise typer.BadParameter("give one RESULT and its TRUTH, or methods and --scene.")
    if out is not None:
        raise typer.BadParameter("--out works for comparisons only; give --scene as well.")
    result, truth = paths
    scoring.score(result, truth, mask, border)
