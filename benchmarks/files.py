"""Each real file: what it is taken for, its views, the range found, seconds; and our map against Lytro's own depth."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.errors import BenchmarkError
from lfgpu.contract import Float32Array
from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_folder, inside, read, recognise
from lfgpu.io.lytro.contents import read_contents
from lfgpu.io.lytro.pictures import confidence_table, depth_table
from lfgpu.methods import preset as preset_of
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.viz.figures import disparity_figure, save_png

DATA = Path(os.environ.get("LFGPU_DATA") or Path(__file__).parents[2] / "shared" / "data") / "real"
VIEWS, DEPTH = "IMG_0002-stk.lfp", "IMG_0002-dm.lfp"
"""Of one picture: its views, and Lytro's depth of it."""


@dataclass(frozen=True)
class Row:
    """What came of one file or folder."""

    name: str
    format: str
    views: str
    found: str
    """The range of disparities, or why there is none."""
    reading: float
    """Seconds."""
    depth: float
    """Seconds, NaN where there is no depth."""


@dataclass(frozen=True)
class Agreement:
    """How our disparities of `VIEWS` go with Lytro's λ: Pearson's correlation, over all cells and the surer half."""

    everywhere: float
    surer_half: float
    slope: float
    """Pixels per view step for one λ."""


def run(data: Path, *, preset: str, out: Path | None, say: Callable[[str], None]) -> tuple[list[Row], Agreement | None]:
    """A row for each file and folder of real ones, and the agreement with Lytro where both containers are there.

    Pictures of the maps go into the folder `out`.
    """
    paths = [path for path in _paths(data) if path.exists()]
    if not paths:
        raise BenchmarkError(f"no real files are in {data}; set LFGPU_DATA or --data.")
    rows: list[Row] = []
    maps: dict[str, Float32Array] = {}
    for path in paths:
        name = str(path.relative_to(data))
        say(f"{name} ...")
        row, disparity = _measured(name, path, preset)
        rows.append(row)
        if disparity is not None:
            maps[name] = disparity
    if out is not None:
        with atomic_folder(out) as folder:
            for name, disparity in maps.items():
                save_png(disparity_figure(disparity, name=name), folder / f"{name.replace('/', '_')}.png")
    theirs, ours = data / "lytro" / DEPTH, maps.get(f"lytro/{VIEWS}")
    return rows, None if ours is None or not theirs.is_file() else agreement(ours, theirs)


def agreement(disparity: Float32Array, container: Path) -> Agreement:
    """A map against the depth table of a container, which covers the same picture with fewer cells."""
    contents = read_contents(container)
    if contents.depth is None:
        raise BenchmarkError(f"{container} holds no depth table.")
    table = depth_table(contents.container, contents.depth)
    confidence = confidence_table(contents.container, contents.depth)
    places = [(np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(table.shape, disparity.shape, strict=True)]
    at_cells = ndimage.map_coordinates(disparity, np.meshgrid(*places, indexing="ij"), order=1)
    known = np.isfinite(at_cells) & np.isfinite(table)
    sure = known if confidence is None else known & (confidence > np.median(confidence[known]))
    return Agreement(
        _correlation(at_cells[known], table[known]),
        _correlation(at_cells[sure], table[sure]),
        float(np.polyfit(table[known], at_cells[known], 1)[0]),
    )


def markdown(rows: Sequence[Row], found: Agreement | None) -> str:
    """The rows as a table, and the agreement as a sentence."""
    lines = [
        "| file | taken for | views | range found, px per view step | s to read | s for depth |",
        "|---|---|---|---|---|---|",
        *(
            f"| {row.name} | `{row.format}` | {row.views} | {row.found} | {row.reading:.1f} | "
            f"{'' if np.isnan(row.depth) else f'{row.depth:.1f}'} |"
            for row in rows
        ),
    ]
    if found is not None:
        lines += [
            "",
            f"Disparities of `{VIEWS}` against Lytro's λ in `{DEPTH}`: correlation {found.everywhere:.4f}, over the "
            f"surer half of the cells {found.surer_half:.4f}; {found.slope:.3f} px per view step for one λ.",
        ]
    return "\n".join(lines)


def _paths(data: Path) -> list[Path]:
    containers = sorted((data / "lytro").glob("*.[lL][fF][pP]"))
    folders = ("stanford_knights", "signed_names", "corners", "statue")
    return [*containers, *(data / name for name in folders)]


def _measured(name: str, path: Path, preset: str) -> tuple[Row, Float32Array | None]:
    start = time.perf_counter()
    try:
        form = recognise(path)[0].name
        held = inside(path, format=form)
        if held.no_depth is not None:
            return Row(name, form, dict(held.facts)["contents"], "no views", time.perf_counter() - start, np.nan), None
        lf = read(path, format=form, allow_missing=True)
    except LightFieldError as error:
        return Row(name, "refused", "", str(error), time.perf_counter() - start, np.nan), None
    reading = time.perf_counter() - start
    height, width = lf.size
    grid = "" if lf.grid_shape is None else f" of {lf.grid_shape[0]} x {lf.grid_shape[1]}"
    views = f"{len(lf.views)}{grid}, {width} x {height}"
    start = time.perf_counter()
    try:
        result = estimate_depth(lf, config=preset_of(preset))
    except LightFieldError as error:
        return Row(name, form, views, str(error), reading, time.perf_counter() - start), None
    low, high = result.disparity_range
    found = f"{low:.2f} to {high:.2f}"
    return Row(name, form, views, found, reading, time.perf_counter() - start), result.disparity


def _correlation(a: Float32Array, b: Float32Array) -> float:
    return float(np.corrcoef(a, b)[0, 1])
