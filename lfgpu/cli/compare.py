"""`lfgpu eval` for comparisons: several methods on several scenes, or several batches, as tables and error maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfgpu.errors import LightFieldError
from lfgpu.io.map_formats import REPORT_FILE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from lfgpu.comparison import Scene, Table
    from lfgpu.data.lightfield import LightField
    from lfgpu.metrics import Metrics

_FILES = {
    "table.md": "scores, for a README",
    "table.tex": "the same for LaTeX, with booktabs",
    "table.csv": "the same for programs, with all digits",
    "errors.png": "error maps: a row per scene, a column per method",
    REPORT_FILE: "start here: scores and maps side by side on one page",
}


def compare(methods: list[Path], scenes: list[Path], out: Path | None, border: int | None) -> None:
    """Score methods on scenes, print the table, and write files into the folder `out`, if given."""
    from lfgpu.cli.summary import show_outputs
    from lfgpu.comparison import table
    from lfgpu.io import check_writable
    from lfgpu.metrics import BORDER

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
    from lfgpu.batch.items import MANIFEST_FILE

    return all((folder / MANIFEST_FILE).is_file() for folder in folders)


def compare_batches(folders: list[Path], out: Path | None) -> None:
    """Print the scores that batches recorded: of each item with ground truth, and their averages."""
    from lfgpu.batch.manifest import DONE, read_manifest, standing
    from lfgpu.cli.console import remark
    from lfgpu.cli.summary import show_outputs
    from lfgpu.comparison import table_of
    from lfgpu.io import check_writable
    from lfgpu.metrics import BORDER

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
        from lfgpu.io import atomic_folder

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
    from lfgpu.cli.console import comparison, output, remark

    console = output()
    comparison(console, scored)
    remark(
        console,
        f"Smaller is better. A border of {border} px is left out. BadPix is in percent and counts undefined pixels as "
        "bad.",
    )
    return console


def _metrics(found: dict[str, float | None], folder: Path) -> Metrics:
    from lfgpu.metrics import Metrics

    try:
        return Metrics(**{name: float("nan") if value is None else value for name, value in found.items()})  # type: ignore[arg-type]
    except TypeError as error:
        raise LightFieldError(
            f"{folder} was written by another version of lfgpu, with other metrics; run the batch again."
        ) from error


def _write(out: Path, scenes: list[Scene], scored: Table) -> None:
    from lfgpu.io import atomic_folder
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

    from lfgpu.comparison import Scene
    from lfgpu.io import read

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
    from lfgpu.io import MAP_FORMATS, holds_map, result_in

    single = [method / f"{scene}{suffix}" for entry in MAP_FORMATS for suffix in entry.suffixes]
    found = result_in(method / scene) or next((file for file in single if holds_map(file)), None)
    return found or (
        result_in(method) if alone else None
    )  # with several scenes, one file would be scored on each of them


def _map(file: Path, lf: LightField) -> NDArray[np.float32]:
    from lfgpu.data.summary import view_at
    from lfgpu.io import load, one_map

    assert lf.truth is not None  # the caller looked
    result = one_map(load(file), lf.truth.position)
    if result.position is not None and result.position != lf.truth.position:
        raise LightFieldError(
            f"{file} belongs to the view at {view_at(result.position)}, but the ground truth of {lf.name} belongs to "
            f"the view at {view_at(lf.truth.position)}; give a result of that view."
        )
    return result.disparity
