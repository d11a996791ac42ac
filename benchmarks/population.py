"""Errors of presets on a population of light fields, with the range found and with the true one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks import cases, clock, drawn, results, runs, scoring
from benchmarks.errors import BenchmarkError
from benchmarks.options import Out, Presets, check_known, check_out, listed, say
from benchmarks.results import Record, Run
from benchmarks.runs import FOUND, RANGES
from lfgpu import LightField, estimate_depth, evaluate, read, scenes
from lfgpu.comparison import Scene
from lfgpu.config import Config
from lfgpu.data import GroundTruth
from lfgpu.errors import LfgpuError
from lfgpu.io import atomic_write
from lfgpu.methods import preset as named_preset
from lfgpu.metrics import sparsification
from lfgpu.viz.sheets import comparison

KIND = "accuracy"
BASELINE = results.FOLDER / "accuracy-0.1.json"
"""Version 0.1, that later versions are compared with."""

Source = Callable[[], LightField]


def command(
    folders: Annotated[list[Path] | None, typer.Argument(metavar="[FOLDER]...", help="More of the population.")] = None,
    first: Annotated[
        list[Path] | None,
        typer.Option("--population", metavar="FOLDER", help="A light field with its truth, or a folder of some."),
    ] = None,
    presets: Presets = "fast,accurate",
    ranges: Annotated[
        str, typer.Option(metavar="NAME,...", help="found: by the estimate; true: the true one and 0.1 px more.")
    ] = ",".join(RANGES),
    baseline: Annotated[
        Path, typer.Option(metavar="FILE.json", show_default="version 0.1", help="A run to compare with.")
    ] = BASELINE,
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME-CASE,...", help="Scenes of the package: boxes-7x7x375x375 ...")
    ] = "",
    draws: Annotated[
        int, typer.Option("--drawn", metavar="N", min=0, help="Light fields of the package, drawn at random.")
    ] = 0,
    seed: Annotated[int, typer.Option("--first", metavar="SEED", min=0, help="Seed of the first one.")] = 0,
    sheet: Annotated[Path | None, typer.Option(metavar="FILE.png", help="File of the pictures of errors.")] = None,
    out: Out = None,
) -> None:
    """Score presets on a population of light fields, with the range found and the true one, against a baseline."""
    paths = scoring.light_fields([*(first or ()), *(folders or ())])
    sources: dict[str, Source] = {name: partial(read, path) for name, path in paths.items()}
    sources |= {name: made(name) for name in listed(scene_names)} | drawn.drawn(seed, draws)
    if not sources:
        raise BenchmarkError(
            "no light fields to score: give folders with --population, or --scenes of the package, or --drawn."
        )
    check_known(listed(ranges), "range", RANGES)
    check_out(out, sheet)
    old = results.load(baseline) if baseline != BASELINE or baseline.exists() else None
    pictures: list[Scene] = []
    found = run(sources, {name: named_preset(name) for name in listed(presets)}, listed(ranges), pictures.append)
    if sheet is not None and pictures:
        with atomic_write(sheet) as temporary:
            comparison(pictures).save(temporary, format="png")
    runs.finish(found, out)
    if old is not None:
        runs.against(found, old).show()


def made(name: str) -> Source:
    """Return a scene of the package by name and case, "boxes-7x7x375x375"; BenchmarkError if there is none such."""
    scene, _, case = name.partition("-")
    if scene not in scenes.NAMES:
        raise BenchmarkError(f"unknown scene {name!r}; write NAME-CASE with one of {', '.join(scenes.NAMES)}.")
    return partial(cases.parse(case).make, scene)


def run(
    sources: Mapping[str, Source],
    configs: Mapping[str, Config],
    ranges: Sequence[str],
    draw: Callable[[Scene], object] = lambda _: None,
    *,
    check_cameras: bool = True,
) -> Run:
    """Estimate each light field with each configuration and range; `draw` is given each scene with its maps.

    An estimate that fails is a record that says why.
    """
    records: list[Record] = []
    begun = Run.begun("population")
    for scene, source in sources.items():
        try:
            lf = source()
            truth = scoring.truth_of(lf)
        except LfgpuError as error:
            records.append(Record(KIND, "", "", scene, "all presets", failed=str(error)))
            continue
        scored = truth.disparity if truth.mask is None else np.where(truth.mask, truth.disparity, np.float32(np.nan))
        picture = Scene(scene, lf.image(lf.reference_index), scored)
        for preset, config in configs.items():
            scoring.load_kernels(config)
            for given in ranges:
                say(f"{scene}: {preset}, range {given}")
                records.append(_measured(picture, lf, truth, preset, config, given, check_cameras))
        draw(picture)
    return replace(begun, records=records)


def _measured(
    picture: Scene, lf: LightField, truth: GroundTruth, preset: str, config: Config, given: str, check_cameras: bool
) -> Record:
    scene, name, (low, high) = picture.name, f"{preset}, range {given}", scoring.true_range(lf, margin=0)
    bounds = None if given == FOUND else scoring.true_range(lf)
    try:
        result = estimate_depth(lf, config=config, disparity_range=bounds, check_cameras=check_cameras)
    except LfgpuError as error:
        return Record(KIND, "", "", scene, name, failed=str(error))
    picture.maps[name] = result.disparity
    metrics = evaluate(result.disparity, truth.disparity, mask=truth.mask)
    curve = sparsification(result.disparity, result.confidence, truth.disparity, mask=truth.mask)
    first, last = result.disparity_range
    span = (last - first) / max(high - low, scoring.MARGIN)
    return Record(
        KIND,
        result.backend,
        result.device,
        scene,
        name,
        clock.spread([result.timings["total"]]),
        errors={**scoring.errors(metrics), "ause": curve.ause, "span": span},
        compared=f"truth of the data set, {metrics.count} pixels",
        details={"preset": preset, "range": given, "searched": [first, last], "true": [low, high]},
    )
