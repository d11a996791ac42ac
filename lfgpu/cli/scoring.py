"""Work of `lfgpu eval`: scores of a map, comparisons of methods and of batches, submissions to the benchmark."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from lfgpu import metrics
from lfgpu.batch.items import MANIFEST_FILE
from lfgpu.batch.manifest import DONE, read_manifest, standing
from lfgpu.cli import console as shown
from lfgpu.cli.console import comparison, output, region_scores, remark, scores
from lfgpu.cli.summary import scored_where, show_outputs
from lfgpu.comparison import Scene, Table, table, table_of
from lfgpu.data import DepthResult, DisparityMap, GroundTruth, LightField, ViewsResult
from lfgpu.data.summary import view_at
from lfgpu.errors import LightFieldError
from lfgpu.io import (
    MAP_FORMATS,
    atomic_folder,
    check_writable,
    holds_map,
    load,
    one_map,
    read,
    read_map,
    read_mask,
    result_in,
)
from lfgpu.io.hci_submission import read_region_masks, write_submission
from lfgpu.io.map_formats import REPORT_FILE
from lfgpu.metrics import BORDER, Metrics, evaluate, evaluate_regions, other_unit

_FILES = {
    "table.md": "scores, for a README",
    "table.tex": "the same for LaTeX, with booktabs",
    "table.csv": "the same for programs, with all digits",
    "errors.png": "error maps: a row per scene, a column per method",
    REPORT_FILE: "start here: scores and maps side by side on one page",
}


def score(result: Path, truth: Path, mask: Path | None, border: int | None) -> None:
    """Score a map against its ground truth, a map or a light field, and print the scores."""
    left_out = BORDER if border is None else border
    maps, estimate = _maps(result, truth)
    true = _truth(truth, None if estimate is None else estimate.position)
    where = true.mask if mask is None else read_mask(mask)
    rows = {name: evaluate(values, true.disparity, mask=where, border=left_out) for name, values in maps.items()}
    console = output()
    scores(console, rows)
    remark(console, scored_where(next(iter(rows.values())).count, left_out))
    if (doubt := other_unit(list(maps.values())[-1], true.disparity, mask=where)) is not None:
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
        shown.sparsification(console, curve)


def submit(results: list[Path], out: Path) -> None:
    """Write a submission from folders that depth wrote; what is missing is said."""
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


def compare(methods: list[Path], scenes: list[Path], out: Path | None, border: int | None) -> None:
    """Score methods on scenes, print the table, and write files into the folder `out`, if given."""
    if out is not None:
        check_writable(out)
    _check_names("methods", "column", [method.resolve().name for method in methods])
    for method in methods:
        if not method.exists():
            raise LightFieldError(f"{method} does not exist; give folders that hold one result for each scene.")
    left_out = BORDER if border is None else border
    found = [_scene(scene, methods, left_out, alone=len(scenes) == 1) for scene in scenes]
    _check_names("scenes", "row", [scene.name for scene in found])
    scored = table(found)
    console = _show(scored, left_out)
    if out is not None:
        _write(out, found, scored)
        show_outputs(console, out, list(_FILES.items()))


def are_batches(folders: list[Path]) -> bool:
    """Tell whether all folders are outputs of `lfgpu batch`."""
    return all((folder / MANIFEST_FILE).is_file() for folder in folders)


def compare_batches(folders: list[Path], out: Path | None) -> None:
    """Print the scores that batches recorded: of each item with ground truth, and their averages."""
    if out is not None:
        check_writable(out)
    names = [folder.resolve().name for folder in folders]
    _check_names("batches", "column", names)
    scores: dict[str, dict[str, Metrics]] = {}
    unscored = gone = 0
    mixed = []
    for name, folder in zip(names, folders, strict=True):
        entries = read_manifest(folder)
        there = standing(entries, folder)
        gone += len(entries) - len(there)
        parameters = set()
        for item, entry in sorted(there.items()):
            if entry.get("status") == DONE and entry.get("metrics"):
                scores.setdefault(item, {})[name] = _metrics(entry["metrics"], folder)
                parameters.add(entry.get("parameters_key"))
            else:
                unscored += 1
        if len(parameters) > 1:
            mixed.append(name)
    if not scores:
        raise LightFieldError(
            f"no item in {', '.join(map(str, folders))} has ground truth, so there is nothing to compare."
        )
    scored = table_of(tuple(names), scores)
    console = _show(scored, BORDER)
    if unscored:
        remark(console, f"{unscored} item{'s' * (unscored > 1)} failed or without ground truth.")
    if gone:
        remark(console, f"{gone} items are left out, because their outputs were deleted or renamed.")
    for name in mixed:
        remark(console, f"The items of {name} have different parameters; run the batch again to bring them up to date.")
    if out is not None:
        with atomic_folder(out) as folder:
            _write_tables(folder, scored)
        show_outputs(console, out, [(name, what) for name, what in _FILES.items() if name.startswith("table")])


def _check_names(what: str, line: str, names: list[str]) -> None:
    """Raise LightFieldError if a name occurs twice: names are the titles of rows and columns."""
    for name in names:
        if names.count(name) > 1:
            raise LightFieldError(
                f"two {what} are called {name!r}, but the name is the title of the {line}; rename one folder."
            )


def _show(scored: Table, border: int) -> Console:
    console = output()
    comparison(console, scored)
    remark(
        console,
        f"Smaller is better. A border of {border} px is left out. BadPix is in percent and counts undefined pixels as "
        "bad.",
    )
    return console


def _metrics(found: dict[str, float | None], folder: Path) -> Metrics:
    try:
        return Metrics(**{name: float("nan") if value is None else value for name, value in found.items()})  # type: ignore[arg-type]
    except TypeError as error:
        raise LightFieldError(
            f"{folder} was written by another version of lfgpu, with other metrics; run the batch again."
        ) from error


def _write(out: Path, scenes: list[Scene], scored: Table) -> None:
    from lfgpu.reports.comparison import write_comparison
    from lfgpu.viz.pictures import save_picture
    from lfgpu.viz.sheets import comparison

    with atomic_folder(out) as folder:
        _write_tables(folder, scored)
        save_picture(comparison(scenes), folder / "errors.png")
        write_comparison(folder / REPORT_FILE, scenes, scored)


def _write_tables(folder: Path, scored: Table) -> None:
    for name, text in (("table.md", scored.markdown()), ("table.tex", scored.latex()), ("table.csv", scored.csv())):
        (folder / name).write_text(text, encoding="utf-8")


def _scene(path: Path, methods: list[Path], border: int, *, alone: bool) -> Scene:
    lf = read(path, allow_missing=True)
    if lf.truth is None:
        raise LightFieldError(
            f"{path} holds no ground truth, so nothing can be scored on it; give a light field with ground truth."
        )
    truth = lf.truth.scored
    name = path.resolve().name
    maps = {}
    for method in methods:
        file = _result(method, name, alone=alone)
        if file is not None:
            maps[method.resolve().name] = _map(file, lf)
    if not maps:
        raise LightFieldError(
            f"no method has a result of {name}; put it at METHOD/{name}/result.npz or METHOD/{name}.pfm, or, with a "
            "single scene, in METHOD itself."
        )
    u, v = lf.truth.position
    return Scene(name, lf.image(lf.index_of(v, u)), truth, maps, border)


def _result(method: Path, scene: str, *, alone: bool) -> Path | None:
    """Return the file with a method's result on a scene; None if there is none."""
    single = [method / f"{scene}{suffix}" for entry in MAP_FORMATS for suffix in entry.suffixes]
    found = result_in(method / scene) or next((file for file in single if holds_map(file)), None)
    # With several scenes, one file would be scored on each of them.
    return found or (result_in(method) if alone else None)


def _map(file: Path, lf: LightField) -> NDArray[np.float32]:
    assert lf.truth is not None  # the caller looked
    result = one_map(load(file), lf.truth.position)
    if result.position is not None and result.position != lf.truth.position:
        raise LightFieldError(
            f"{file} belongs to the view at {view_at(result.position)}, but the ground truth of {lf.name} belongs to "
            f"the view at {view_at(lf.truth.position)}; give a result of that view."
        )
    return result.disparity
