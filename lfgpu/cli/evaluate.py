"""`lfgpu eval`: the error of a disparity map against ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfgpu.data.lightfield import GroundTruth
    from lfgpu.data.result import DepthResult, DisparityMap


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

    Results of `lfgpu depth` also get a sparsification curve: the share of bad pixels among the most confident ones.
    Several methods on several scenes (--scene) give one table; -o writes it as table.md, table.tex and table.csv, the
    error maps as errors.png, and report.html with all of it. Several batches give one table of all items with ground
    truth.
    """
    if submission is not None:
        if scenes or out is not None or mask is not None or border is not None:
            raise LightFieldError(
                "--hci-submission goes with results only; leave --scene, --out, --mask, --border out."
            )
        _submit(paths, submission)
        return
    if scenes:
        if mask is not None:
            raise LightFieldError(
                "--mask does not work with --scene, which uses the masks of the light fields; leave --mask out."
            )
        from lfgpu.cli.compare import compare

        compare(paths, scenes, out, border)
        return
    from lfgpu.cli.compare import are_batches, compare_batches

    if are_batches(paths):
        if mask is not None or border is not None:
            raise LightFieldError(
                "--mask and --border do not work with batches, which were scored when they ran; leave them out, or "
                "give --scene."
            )
        compare_batches(paths, out)
        return
    if len(paths) != 2:
        raise typer.BadParameter("give one RESULT and its TRUTH, or methods and --scene.")
    if out is not None:
        raise typer.BadParameter("--out works for comparisons only; give --scene as well.")
    result, truth = paths
    _score(result, truth, mask, border)


def _score(result: Path, truth: Path, mask: Path | None, border: int | None) -> None:
    from lfgpu import metrics
    from lfgpu.cli.console import output, region_scores, remark, scores, sparsification
    from lfgpu.cli.summary import scored_where
    from lfgpu.io import read_mask
    from lfgpu.io.hci_submission import read_region_masks
    from lfgpu.metrics import evaluate_regions

    left_out = metrics.BORDER if border is None else border
    maps, estimate = _maps(result, truth)
    true = _truth(truth, None if estimate is None else estimate.position)
    where = true.mask if mask is None else read_mask(mask)
    rows = {
        name: metrics.evaluate(values, true.disparity, mask=where, border=left_out) for name, values in maps.items()
    }
    console = output()
    scores(console, rows)
    remark(console, scored_where(next(iter(rows.values())).count, left_out))
    if (doubt := metrics.other_unit(list(maps.values())[-1], true.disparity, mask=where)) is not None:
        remark(console, doubt)
    if truth.is_dir() and (regions := read_region_masks(truth)):
        region_scores(
            console,
            {name: evaluate_regions(values, true.disparity, regions, border=left_out) for name, values in maps.items()},
        )
    if estimate is not None and estimate.confidence is not None:
        curve = metrics.sparsification(
            estimate.disparity, estimate.confidence, true.disparity, mask=where, border=left_out
        )
        sparsification(console, curve)


def _submit(results: list[Path], out: Path) -> None:
    """Write a submission from folders that depth wrote; what is missing is said."""
    from lfgpu.cli.console import output, remark
    from lfgpu.cli.summary import show_outputs
    from lfgpu.data.result import DepthResult
    from lfgpu.io import check_writable, load
    from lfgpu.io.hci_submission import write_submission

    check_writable(out)
    found = {}
    for path in results:
        _check_exists(path)
        result = load(path)
        if not isinstance(result, DepthResult) or "total" not in result.timings:
            raise LightFieldError(f"{path} does not say how long it took; give folders that depth wrote.")
        scene = path.resolve().name.lower() if path.is_dir() else path.stem.lower()
        if scene in found:
            raise LightFieldError(f"{path} is a second result of the scene {scene!r}; give one of each.")
        found[scene] = (result.disparity, result.timings["total"])
    missing = write_submission(out, found)
    console = output()
    show_outputs(console, out, [("disp_maps/", f"{len(found)} maps"), ("runtimes/", "seconds, of the estimate alone")])
    if missing:
        remark(console, f"The benchmark takes all twelve scenes; {len(missing)} are missing: {', '.join(missing)}.")


def _maps(path: Path, truth: Path) -> tuple[dict[str, NDArray[np.float32]], DepthResult | DisparityMap | None]:
    """Read the maps to score, by name (the stages of a result), and the estimate itself, if its view is known."""
    from lfgpu.data.result import DepthResult
    from lfgpu.data.views_result import ViewsResult
    from lfgpu.io import load, one_map, read, result_in

    _check_exists(path)
    whole = load(path)
    file = result_in(path) or path if path.is_dir() else path
    if isinstance(whole, DepthResult):
        return whole.disparity_stages, whole
    several = isinstance(whole, ViewsResult)
    known = read(truth, allow_missing=True).truth if several and truth.is_dir() else None
    found = one_map(whole, None if known is None else known.position)
    return {file.name: found.disparity}, None if found.position is None else found


def _check_exists(path: Path) -> None:
    if not path.exists():
        raise LightFieldError(
            f"{path} does not exist; give a map, a folder that `lfgpu depth` wrote, or a light field."
        )


def _truth(path: Path, position: tuple[float, float] | None) -> GroundTruth:
    """Read the ground truth in a map or a light field. It must belong to the view at `position` (u, v), if known."""
    from lfgpu.data.lightfield import GroundTruth
    from lfgpu.data.summary import view_at
    from lfgpu.io import read, read_map

    _check_exists(path)
    if not path.is_dir():
        return GroundTruth(read_map(path), position or (0.0, 0.0))
    known = read(path, allow_missing=True).truth
    if known is None:
        raise LightFieldError(f"{path} holds no ground truth; give a map of it, or another light field.")
    if position is not None and known.position != position:
        raise LightFieldError(
            f"the ground truth in {path} belongs to the view at {view_at(known.position)}, but the result belongs to "
            f"the view at {view_at(position)}; give a result of that view."
        )
    return known
