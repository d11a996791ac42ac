"""Flicker of maps of a moving scene, with and without the last map, beside their errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from statistics import fmean, geometric_mean, median
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from benchmarks.moving import RANGE, Film
from benchmarks.options import CaseName, DeviceName, Out, Presets, Row, check_known, collected, listed, say
from benchmarks.tables import Table
from lfgpu import DepthStream, TemporalPrior, evaluate
from lfgpu.contract import Float32Array

_SETTLED = 3  # frames after which a map rests on several


_TITLES = {
    "mse_100": "MSE x100",
    "badpix_07": "BadPix 0.07",
    "badpix_03": "0.03",
    "badpix_01": "0.01",
    "unknown": "unknown, %",
    "flicker": "flicker",
    "flicker_median": "median",
    "flicker_still": "still",
    "flicker_moving": "moving",
    "work_ms": "ms",
}
_COMPARED = "mse_100", "badpix_07", "badpix_01", "flicker", "flicker_still", "flicker_moving"

PASTS = {
    "none": None,
    "costs only": TemporalPrior(persistence=0.0),
    "mean only": TemporalPrior(strength=0.0),
    "whole": TemporalPrior(),
}


def command(
    case_name: CaseName = "5x5x128x128",
    frames: Annotated[int, typer.Option(min=6)] = 24,
    period: Annotated[int, typer.Option(min=1, help="Frames in which things go round; fewer is faster.")] = 240,
    noise: Annotated[float, typer.Option(help="Noise of the views; intensities are 0 to 1.")] = 0.01,
    seeds: Annotated[str, typer.Option(metavar="N,...", help="Seeds of the scenes; one film for each.")] = "0,1,2,3",
    presets: Presets = "accurate,fast",
    pasts: Annotated[str, typer.Option(metavar="NAME,...", help="Uses of the last map.")] = ",".join(PASTS),
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Measure the flicker of maps of moving scenes, with and without the last map, and their errors."""
    check_known(listed(pasts), "past", PASTS)
    film = Film.of(case_name, frames, period=period, noise=noise)
    films = (replace(film, seed=int(seed)) for seed in listed(seeds))
    rows = (row for film in films for row in run(film, listed(presets), listed(pasts), device))
    show(collected(rows, out, benchmark="flicker", about={"film": asdict(film)}))


def run(film: Film, presets: Sequence[str], pasts: Sequence[str], device: str | None) -> Iterator[Row]:
    """Take the film in each way; yields means over its frames, errors over the pixels that are known.

    `unknown` is the share of the others, per cent. Flicker is in 1/1000 px per view step.
    """
    say(f"seed {film.seed}: casting {film.count} frames")
    frames, motions = film.frames(), list(film.motions())
    for preset in presets:
        for past in pasts:
            prior = PASTS[past]
            say(f"seed {film.seed}, {preset}, past: {past}")
            with DepthStream(
                frames[0], config=preset, disparity_range=RANGE, device=device, prior=prior, policy="block", cut=1.0
            ) as stream:
                maps = [stream.push(lf.views).numpy() for lf in frames]
                work = stream.stats()["work_p50_ms"]
            metrics = [evaluate(one, lf.truth.disparity) for one, lf in zip(maps, frames, strict=True) if lf.truth]
            found = {**_errors(maps, metrics[_SETTLED:]), **_flicker(maps, motions), "work_ms": work}
            yield {"seed": film.seed, "preset": preset, "past": past, **found}


def _errors(maps: list[Float32Array], metrics: list[Any]) -> Row:
    names = ("mse_100", "badpix_07", "badpix_03", "badpix_01")
    errors: Row = {name: fmean(getattr(one, name) for one in metrics) for name in names}
    return {**errors, "unknown": 100 * fmean(float(np.isnan(one).mean()) for one in maps[_SETTLED:])}


def _flicker(maps: list[Float32Array], motions: list[Any]) -> Row:
    changes = [m.flicker(*maps[i : i + 2]) * 1000 for i, m in enumerate(motions)][_SETTLED:]
    known = [~np.isnan(change) for change in changes]
    still = [m.still()[k] for m, k in zip(motions[_SETTLED:], known, strict=True)]
    changes = [change[k] for change, k in zip(changes, known, strict=True)]
    return {
        "flicker": _mean(changes),
        "flicker_median": median(float(np.median(c)) for c in changes),
        "flicker_still": _mean([c[s] for c, s in zip(changes, still, strict=True)]),
        "flicker_moving": _mean([c[~s] for c, s in zip(changes, still, strict=True)]),
    }


def _mean(frames: list[NDArray[np.float64]]) -> float:
    """Average the means of those frames that have pixels of the kind; NaN if none has."""
    means = [float(values.mean()) for values in frames if values.size]
    return fmean(means) if means else float("nan")


def show(rows: list[Row]) -> None:
    """Print a table; all numbers are the lower the better. Over several films, ratios say what the past changes."""
    words = {name: f"{{{name}}}" for name in ("seed", "preset", "past")}
    Table.of("", 3, rows, {**words, **{title: f"{{{name}:.2f}}" for name, title in _TITLES.items()}}).show()
    typer.echo(
        "Flicker: mean |change of the map along the true motion, less the true change|, 1/1000 px per view step, where "
        "a surface is seen before and after; its median; its mean where nothing moves, and on what moves."
    )
    for preset, past, ratios in against_none(rows):
        said = ", ".join(f"{name} {mean:.3f} (worst {worst:.3f})" for name, (mean, worst) in ratios.items())
        typer.echo(f"{preset}, past {past} to none, geometric means over films: {said}.")


def against_none(rows: list[Row]) -> Iterator[tuple[str, str, dict[str, tuple[float, float]]]]:
    """Yield (preset, past, ratios): geometric mean and largest ratio over the films to the same film without a past."""
    none = {(row["seed"], row["preset"]): row for row in rows if row["past"] == "none"}
    for preset, past in dict.fromkeys((row["preset"], row["past"]) for row in rows if row["past"] != "none"):
        these = [row for row in rows if (row["preset"], row["past"]) == (preset, past)]
        if some := [row for row in these if (row["seed"], preset) in none]:
            ratios = {name: [row[name] / none[row["seed"], preset][name] for row in some] for name in _COMPARED}
            yield preset, past, {name: (geometric_mean(found), max(found)) for name, found in ratios.items()}
