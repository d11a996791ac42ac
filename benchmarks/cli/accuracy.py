"""Errors of maps and of what is made of them: populations, ablations, confidence, views, tiles, files, the paper."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from benchmarks import (
    ablation,
    confidence,
    drawn,
    error_sheet,
    files,
    live,
    machine,
    paper,
    population,
    rendering,
    results,
    show,
    tables,
    tile_differences,
)
from benchmarks.cli.options import Data, Out, Presets, check_known, listed
from benchmarks.cli.outputs import check_out, collected, finish, say
from benchmarks.errors import BenchmarkError
from lfgpu.io.atomic import check_writable


def ablation_(
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME,...", help=f"{', '.join(s.name for s in ablation.SCENES)}.")
    ] = "",
    size: Annotated[int, typer.Option(min=48, help="Pixels along each side of the ray-cast scenes.")] = 256,
    seeds: Annotated[int, typer.Option(min=1, help="How many of each ray-cast scene; errors are means over them.")] = 1,
    data: Data = ablation.DATA,
    out: Out = None,
) -> None:
    """Leave out each ingredient of the preset `accurate`, one at a time, and print what that does to the errors."""
    plan = ablation.Plan(
        scenes=tuple(ablation.find(n) for n in listed(scene_names)) or ablation.SCENES,
        size=size,
        seeds=seeds,
        data=data,
        variants=ablation.VARIANTS,
    )
    check_out(out)
    finish(ablation.run(plan, say), out)


def accuracy_(
    folders: Annotated[
        list[Path] | None, typer.Argument(metavar="[FOLDER]...", help="More folders of the population.")
    ] = None,
    first: Annotated[
        list[Path] | None,
        typer.Option("--population", metavar="FOLDER", help="A light field with its truth, or a folder of some."),
    ] = None,
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = ",".join(population.PRESETS),
    ranges: Annotated[
        str, typer.Option(metavar="NAME,...", help="found: by the estimate; true: the true one and 0.1 px more.")
    ] = ",".join(population.RANGES),
    baseline: Annotated[Path, typer.Option(metavar="FILE.json", help="A run to hold this one against.")] = (
        population.BASELINE
    ),
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME-CASE,...", help="Scenes of the package: boxes-7x7x375x375 ...")
    ] = "",
    draws: Annotated[
        int, typer.Option("--drawn", metavar="N", min=0, help="Light fields of the package, drawn at random.")
    ] = 0,
    seed: Annotated[int, typer.Option("--first", metavar="SEED", min=0, help="Seed of the first one.")] = 0,
    sheet: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Where the pictures of errors go.")] = None,
    out: Out = None,
) -> None:
    """Score presets on a population of light fields, with the range found and the true one, against a baseline."""
    where = [*(first or ()), *(folders or ())]
    others = {**{name: population.made(name) for name in listed(scene_names)}, **drawn.drawn(seed, draws)}
    if not where and not others:
        raise BenchmarkError(
            "no light fields to score: give folders with --population, or --scenes of the package, or --drawn."
        )
    check_known(listed(ranges), "range", population.RANGES)
    check_out(out, sheet)
    old = results.load(baseline) if baseline != population.BASELINE or baseline.exists() else None
    pictures: list[population.Picture] = []
    run = population.run(where, listed(presets), listed(ranges), say, pictures.append, others)
    if sheet is not None and pictures:
        error_sheet.write(pictures, sheet)
    finish(run, out)
    if old is not None and {r.case for r in run.records} & {r.case for r in old.records}:
        show.table(tables.against(run, old))


def confidence_(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Light fields with truth, or folders.")],
    fit: Annotated[
        bool,
        typer.Option("--fit", help="Fit the weights, also on the package's own scenes, and write them to the method."),
    ] = False,
    presets: Presets = "fast,accurate",
    diagram: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Where the reliability diagram goes.")
    ] = None,
    out: Out = None,
) -> None:
    """What the confidence says against what is true; with `--fit`, weights for each scene are those of the others."""
    check_out(diagram, out)
    about = {**machine.about(), "presets": listed(presets), "fitted": fit}
    found = confidence.samples(folders, listed(presets), say)
    fitted = [*found, *confidence.own_samples(listed(presets), say)] if fit else []
    weights = confidence.fit(fitted) if fit else confidence.NOW
    with_all = [sample.judged(weights) for sample in found]
    judged = confidence.by_the_others(fitted, say) if fit else with_all
    rows = confidence.rows(judged)
    live.save(out, {**about, "rows": [asdict(row) for row in rows]})
    for table in confidence.tables(rows):
        show.table(table)
    if diagram is not None:
        groups = {"fitted on other scenes": judged, "fitted on all": with_all} if fit else {"present weights": judged}
        confidence.draw(groups, diagram)
    if fit:
        typer.echo(f"written: {confidence.write(weights, fitted)}: {weights.share}, {weights.spread}")


def rendering_(
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME,...", help=f"Default: {', '.join(rendering.SCENES)}.")
    ] = "",
    preset: Annotated[
        str, typer.Option(metavar="NAME", help="Preset for the maps of the views that are kept.")
    ] = "accurate",
    every: Annotated[int, typer.Option(min=1, help="Render every so many of the views that are left out.")] = 1,
    data: Data = rendering.DATA,
    out: Out = None,
) -> None:
    """Leave out every second row and column of views, render them from the rest, and print how near that comes."""
    check_out(out)
    scenes = tuple(listed(scene_names)) or rendering.SCENES
    rows = collected(
        rendering.run(scenes, data, preset=preset, every=every, say=say),
        out,
        {**machine.about(), "preset": preset, "every": every},
    )
    typer.echo(rendering.markdown(rows), nl=False)


def files_(
    preset: Annotated[str, typer.Option(metavar="NAME", help="Preset for the maps.")] = "fast",
    data: Annotated[
        Path, typer.Option(metavar="FOLDER", help="The real files; default: real in $LFGPU_DATA, or in ../shared/data.")
    ] = files.DATA,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FOLDER", help="Where pictures of maps go.")
    ] = None,
) -> None:
    """Read each real file and estimate its depth, and hold one map against Lytro's own."""
    if out is not None:
        check_writable(out)
    rows, found = files.run(data, preset=preset, out=out, say=say)
    typer.echo(files.markdown(rows, found))


def tile_differences_(
    presets: Presets = "fast,accurate",
    out: Out = None,
) -> None:
    """How far maps in 2 x 2 tiles are from those in one piece, after each stage."""
    check_out(out)
    rows = tile_differences.run(listed(presets))
    live.save(out, {**tile_differences.about(), "rows": rows})
    for row in rows:
        typer.echo(", ".join(f"{name} {value}" for name, value in row.items()))


def paper_(
    names: Annotated[
        str, typer.Option("--experiments", metavar="NAME,...", help=f"{', '.join(e.name for e in paper.EXPERIMENTS)}.")
    ] = "",
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = ",".join(paper.PRESETS),
    data: Data = ablation.DATA,
    pictures: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Where pictures go: docs/paper.")] = None,
    out: Out = None,
) -> None:
    """Repeat the paper's experiments, and hold the kernels against its printed equations."""
    check_known(listed(names), "experiment", tuple(sorted(experiment.name for experiment in paper.EXPERIMENTS)))
    check_out(out)
    found = paper.run(data, listed(names), pictures, say, listed(presets))
    if out is not None:
        results.save(found, out)
    for rows in (paper.forms(found), paper.experiments(found)):
        show.table(tables.Table("", rows[0], 1, rows[1:]))
