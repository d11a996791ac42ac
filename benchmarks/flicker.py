"""How quiet maps of a moving scene are, with and without the last map, beside how right they are."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from statistics import fmean, median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.moving import RANGE, Film
from lfgpu import DepthStream, TemporalPrior, evaluate
from lfgpu.contract import Float32Array

_SETTLED = 3  # frames after which a map rests on several


@dataclass(frozen=True)
class Row:
    """One way of taking frames, means over them: errors as in DESIGN section 8, flicker in 1/1000 px per view step."""

    preset: str
    past: str
    mse_100: float
    badpix_07: float
    badpix_03: float
    badpix_01: float
    flicker: float
    flicker_median: float
    flicker_still: float
    flicker_moving: float
    work_ms: float


PASTS = {
    "none": None,
    "costs only": TemporalPrior(persistence=0.0),
    "mean only": TemporalPrior(strength=0.0),
    "whole": TemporalPrior(),
}


def run(film: Film, presets: tuple[str, ...], device: str | None, say: Any) -> list[Row]:
    """Take the film in each way."""
    say(f"casting {film.count} frames")
    frames, motions = film.frames(), list(film.motions())
    rows = []
    for preset in presets:
        for past, prior in PASTS.items():
            say(f"{preset}, past: {past}")
            with DepthStream(
                frames[0], config=preset, disparity_range=RANGE, device=device, prior=prior, policy="block", cut=1.0
            ) as stream:
                maps = [stream.push(lf.views).numpy() for lf in frames]
                work = stream.stats()["work_p50_ms"]
            metrics = [evaluate(one, lf.truth.disparity) for one, lf in zip(maps, frames, strict=True) if lf.truth]
            rows.append(_row(preset, past, maps, metrics[_SETTLED:], motions, work))
    return rows


def _row(preset: str, past: str, maps: list[Float32Array], metrics: list[Any], motions: list[Any], work: float) -> Row:
    changes = [m.flicker(*maps[i : i + 2]) * 1000 for i, m in enumerate(motions)][_SETTLED:]
    still = [m.still() for m in motions][_SETTLED:]
    return Row(
        preset,
        past,
        fmean(m.mse_100 for m in metrics),
        fmean(m.badpix_07 for m in metrics),
        fmean(m.badpix_03 for m in metrics),
        fmean(m.badpix_01 for m in metrics),
        fmean(float(c.mean()) for c in changes),
        median(float(np.median(c)) for c in changes),
        fmean(float(c[s].mean()) for c, s in zip(changes, still, strict=True)),
        fmean(float(c[~s].mean()) for c, s in zip(changes, still, strict=True) if not s.all()),
        work,
    )


def show(rows: list[Row]) -> None:
    """A table; all numbers are the lower the better."""
    table = Table(
        "preset", "past", "MSE x100", "BadPix 0.07", "0.03", "0.01", "flicker", "median", "still", "moving", "ms"
    )
    for row in rows:
        numbers = list(asdict(row).values())[2:]
        table.add_row(row.preset, row.past, *(f"{number:.2f}" for number in numbers))
    console = Console(highlight=False)
    console.width = max(console.width, 110)
    console.print(table)
    console.print(
        "Flicker: mean |change of the map along the true motion, less the true change|, 1/1000 px per view step, where "
        "a surface is seen before and after; its median; its mean where nothing moves, and on what moves."
    )
