"""PSNR of rendered views: every second row and column of views is left out, and rendered from the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.errors import BenchmarkError
from benchmarks.options import DATA, Data, Out, Preset, Row, collected, listed, say
from benchmarks.tables import Table
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import LightField
from lfgpu.io import read
from lfgpu.methods import method_of
from lfgpu.pipelines.all_views import estimate_all_views
from lfgpu.viz.rendering import Renderer

SCENES = ("cotton", "kitchen", "lytro_2067")
METHODS = ("nearest view", "mean of neighbours", "rendered")
BORDER = 15  # pixels, as in the scores of maps


def command(
    scene_names: Annotated[str, typer.Option("--scenes", metavar="NAME,...")] = ",".join(SCENES),
    preset: Preset = "accurate",
    every: Annotated[int, typer.Option(min=1, help="Render every so many of the views that are left out.")] = 1,
    data: Data = DATA,
    out: Out = None,
) -> None:
    """Leave out every second row and column of views, render them from the rest, and print how near that comes."""
    rows = run(listed(scene_names), data, preset=preset, every=every)
    typer.echo(table(collected(rows, out, benchmark="rendering", about={"preset": preset, "every": every})).markdown)


def run(scenes: Sequence[str], data: Path, *, preset: str, every: int) -> Iterator[Row]:
    """Measure each scene; every `every`-th of the views that are left out is rendered.

    PSNR is in dB by method: `whole` of whole views, `inner` with the border left out, `worst` of the worst view, whole.
    `known` is the share of the pixels that some kept view shows.
    """
    there = [name for name in scenes if (data / name).is_dir()]
    for name in scenes:
        if name not in there:
            say(f"{name}: {data / name} is not there, left out.")
            continue
        say(f"{name}: maps of the views that are kept ...")
        yield _measure(name, read(data / name), preset, every)
    if not there:
        raise BenchmarkError("no light field is there; set LFGPU_DATA or --data.")


def table(rows: Sequence[Row]) -> Table:
    """Make the table; the best method of a scene is bold."""
    columns = ("scene", "kept / rendered views", *METHODS, "worst view", "shown by a kept view")
    cells = []
    for row in rows:
        best = max(row["whole"].values())
        marks = {m: "**" if row["whole"][m] == best else "" for m in METHODS}
        found = (f"{marks[m]}{row['whole'][m]:.1f} / {row['inner'][m]:.1f}{marks[m]}" for m in METHODS)
        worst = " / ".join(f"{row['worst'][m]:.1f}" for m in METHODS)
        cells.append(
            (f"`{row['scene']}`", f"{row['kept']} / {row['rendered']}", *found, worst, f"{100 * row['known']:.2f} %")
        )
    return Table("", columns, len(columns), cells)


def split(lf: LightField) -> tuple[LightField, list[int]]:
    """Split into the views in even rows and even columns, counted from the reference, and the indices of the others."""
    even = (np.round(lf.offsets) % 2 == 0).all(axis=1)
    return lf.subset(np.flatnonzero(even).tolist()), np.flatnonzero(~even).tolist()


def psnr(image: Float32Array, true: Float32Array) -> float:
    """Compute the peak signal to noise ratio in dB of pixels, whatever their order, the peak being 1."""
    return float(-10 * np.log10(np.mean((image - true) ** 2)))


def _measure(name: str, lf: LightField, preset: str, every: int) -> Row:
    kept, left_out = split(lf)
    render = Renderer(kept, estimate_all_views(kept, config=method_of(preset).for_rendering))
    wanted = left_out[::every]
    whole, inner = (np.empty((len(wanted), len(METHODS))) for _ in range(2))
    within = np.zeros(lf.size, np.bool_)
    within[BORDER:-BORDER, BORDER:-BORDER] = True
    known = []
    for place, index in enumerate(wanted):
        say(f"{name}: view {place + 1} of {len(wanted)}")
        position, recorded = lf.positions[index], lf.image(index)
        rendered = render(float(position[1]), float(position[0]))
        valid = np.ones(lf.size, np.bool_) if lf.valid is None else lf.valid[index]
        known.append(rendered.known[valid].mean())
        images = (*_baselines(kept, position), rendered.image)
        whole[place] = [psnr(image[valid], recorded[valid]) for image in images]
        inner[place] = [psnr(image[valid & within], recorded[valid & within]) for image in images]
    found = {"whole": whole.mean(0), "inner": inner.mean(0), "worst": whole.min(0)}
    by_method = {name: dict(zip(METHODS, map(float, values), strict=True)) for name, values in found.items()}
    what = {"scene": name, "kept": len(kept.views), "rendered": len(wanted)}
    return {**what, **by_method, "known": float(np.mean(known))}


def _baselines(lf: LightField, position: Float64Array) -> tuple[Float32Array, Float32Array]:
    """Return the nearest view, and the mean of all views that stand as near."""
    distance = np.hypot(*(lf.positions - position).T)
    nearest = np.flatnonzero(distance < distance.min() + 1e-6)
    return lf.image(int(nearest[0])), np.mean([lf.image(int(n)) for n in nearest], axis=0, dtype=np.float32)
