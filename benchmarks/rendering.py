"""How near rendered views come to recorded ones: every second view is left out, and rendered from the rest."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.errors import BenchmarkError
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.io import read
from lfgpu.methods import method_of
from lfgpu.pipelines.all_views import estimate_all_views
from lfgpu.viz.rendering import Renderer

DATA = Path(os.environ.get("LFGPU_DATA") or Path(__file__).parents[2] / "shared" / "data")
SCENES = ("cotton", "kitchen", "lytro_2067")
METHODS = ("nearest view", "mean of neighbours", "rendered")
BORDER = 15  # pixels, as in the scores of maps


@dataclass(frozen=True)
class Row:
    """What came out for one scene: PSNR in dB by method, of whole views and with the border left out."""

    scene: str
    kept: int
    rendered: int
    whole: dict[str, float]
    inner: dict[str, float]
    worst: dict[str, float]
    """Of the worst view, whole."""
    known: float
    """Share of the pixels that some kept view shows."""


def run(scenes: Sequence[str], data: Path, *, preset: str, every: int, say: Callable[[str], None]) -> Iterator[Row]:
    """A row for each scene; every `every`-th of the views that are left out is rendered."""
    count = 0
    for name in scenes:
        if not (data / name).is_dir():
            say(f"{name}: {data / name} is not there, left out.")
            continue
        say(f"{name}: maps of the views that are kept ...")
        yield _measure(name, read(data / name), preset, every, say)
        count += 1
    if not count:
        raise BenchmarkError("no light field is there; set LFGPU_DATA or --data.")


def markdown(rows: Sequence[Row]) -> str:
    """The rows as a table."""
    lines = [
        f"| scene | kept / rendered views | {' | '.join(METHODS)} | worst view | shown by a kept view |",
        f"| --- | --- | {'--- | ' * len(METHODS)}--- | --- |",
    ]
    for row in rows:
        best = max(row.whole.values())
        cells = [
            f"{'**' if row.whole[m] == best else ''}{row.whole[m]:.1f} / {row.inner[m]:.1f}"
            f"{'**' if row.whole[m] == best else ''}"
            for m in METHODS
        ]
        worst = " / ".join(f"{row.worst[m]:.1f}" for m in METHODS)
        lines.append(
            f"| `{row.scene}` | {row.kept} / {row.rendered} | {' | '.join(cells)} | {worst} | {100 * row.known:.2f} % |"
        )
    return "\n".join(lines) + "\n"


def split(lf: LightField) -> tuple[LightField, list[int]]:
    """The views in even rows and even columns, counted from the reference, and the indices of the others."""
    even = (np.round(lf.offsets) % 2 == 0).all(axis=1)
    return lf.subset(np.flatnonzero(even).tolist()), np.flatnonzero(~even).tolist()


def _measure(name: str, lf: LightField, preset: str, every: int, say: Callable[[str], None]) -> Row:
    kept, left_out = split(lf)
    render = Renderer(kept, estimate_all_views(kept, config=method_of(preset).for_rendering))
    wanted = left_out[::every]
    whole, inner = (np.empty((len(wanted), len(METHODS))) for _ in range(2))
    known = []
    for place, index in enumerate(wanted):
        say(f"{name}: view {place + 1} of {len(wanted)}")
        position, recorded = lf.positions[index], lf.image(index)
        rendered = render(float(position[1]), float(position[0]))
        known.append(rendered.known.mean() if lf.valid is None else rendered.known[lf.valid[index]].mean())
        images = (*_baselines(kept, position), rendered.image)
        valid = np.ones(lf.size, np.bool_) if lf.valid is None else lf.valid[index]
        whole[place] = [psnr(image[valid], recorded[valid]) for image in images]
        within = np.zeros(lf.size, np.bool_)
        within[BORDER:-BORDER, BORDER:-BORDER] = True
        inner[place] = [psnr(image[valid & within], recorded[valid & within]) for image in images]
    by_method = [dict(zip(METHODS, map(float, m), strict=True)) for m in (whole.mean(0), inner.mean(0), whole.min(0))]
    mean, inside, worst = by_method
    return Row(name, len(kept.views), len(wanted), mean, inside, worst, float(np.mean(known)))


def psnr(image: Float32Array, true: Float32Array) -> float:
    """Peak signal to noise ratio in dB of pixels, whatever their order, the peak being 1."""
    return float(-10 * np.log10(np.mean((image - true) ** 2)))


def _baselines(lf: LightField, position: Float64Array) -> tuple[Float32Array, Float32Array]:
    """The nearest view, and the mean of all views that stand as near."""
    distance = np.hypot(*(lf.positions - position).T)
    nearest = np.flatnonzero(distance < distance.min() + 1e-6)
    return lf.image(int(nearest[0])), np.mean([lf.image(int(n)) for n in nearest], axis=0, dtype=np.float32)
