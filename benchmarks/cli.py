"""The command line: `python -m benchmarks [options]` measures; `table`, `plot` and `compare` look at what was found.

`accuracy` scores a population of light fields, `ablation` leaves ingredients out, `rendering` renders views that were
left out, `misalignment` lines up cameras that were moved, `judge` looks for a single view that was moved, `live`,
`rectify`, `ring`, `flicker`, `drift` and `soak` are about streams, `scaling` takes several GPUs, `tiles` limits the
memory, `viewer` asks for pictures as pages do, `gallery` draws the picture of the README, `figures` writes the figures
of all pages from the committed results.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from benchmarks import (
    ablation,
    batches,
    cases,
    compare,
    confidence,
    drift,
    error_sheet,
    figures,
    files,
    flicker,
    gallery,
    gpu_parity,
    judge,
    live,
    live_stages,
    machine,
    measuring,
    merge,
    misalignment,
    moving,
    native,
    operations,
    paper,
    pipelines,
    plot,
    population,
    rectify,
    rendering,
    results,
    ring,
    scaling,
    show,
    soak,
    suite,
    tables,
    tile_differences,
    tiles,
    viewer,
)
from benchmarks.errors import BenchmarkError
from lfgpu._backends import list_backends
from lfgpu.cli.failures import Group
from lfgpu.io.atomic import check_writable
from lfgpu.threads import get_threads

_PIPELINES_HELP = f'{", ".join(pipelines.NAMES)}; default: all; or "none".'
app = typer.Typer(
    name="benchmarks",
    cls=Group,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Files = Annotated[list[Path], typer.Argument(metavar="FILE.json...", help="What `--out` wrote; several are merged.")]


def main() -> None:
    """Run and exit: 0 for done, 1 for an error or a finding of `compare`, 2 for wrong usage, 130 for interrupted."""
    app(prog_name="python -m benchmarks")


@app.callback(invoke_without_command=True)
def measure(
    context: typer.Context,
    case_names: Annotated[
        str, typer.Option("--cases", metavar="NAME,...", help="ROWSxCOLUMNSxHEIGHTxWIDTH; default: those for minutes.")
    ] = "",
    operation_names: Annotated[
        str, typer.Option("--operations", metavar="NAME,...", help='Default: all; "none" measures none.')
    ] = "",
    backends: Annotated[str, typer.Option(metavar="NAME,...", help="Default: all.")] = "",
    devices: Annotated[
        str, typer.Option(metavar="NAME,...", help="cpu, cuda:0 ...; default: the CPU and the first GPU.")
    ] = "",
    repeats: Annotated[int, typer.Option(min=1, help="At most; fewer where a call takes long.")] = 15,
    threads: Annotated[int | None, typer.Option(min=1, help="Of the CPU; default: one for each core.")] = None,
    timeout: Annotated[float, typer.Option(min=1, help="Seconds that one process may take.")] = 600,
    pipeline_names: Annotated[
        str,
        typer.Option("--pipelines", metavar="NAME,...", help=_PIPELINES_HELP),
    ] = "",
    runs: Annotated[int, typer.Option(min=1, help="Repeats of the resident method on a GPU.")] = 50,
    startup: Annotated[bool, typer.Option(help="Import and time to the first result.")] = True,
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="Where the results go.")] = None,
) -> None:
    """Measure time, memory and error of every backend on every device, and print a table."""
    if context.invoked_subcommand is not None:
        return
    plan = suite.Plan(
        cases=tuple(cases.find(n) for n in _names(case_names)) or tuple(c for c in cases.CASES if c.default),
        operations=_operations(operation_names),
        backends=tuple(_known_backend(n) for n in _names(backends)) or list_backends(),
        devices=tuple("cuda:0" if n == "cuda" else n for n in _names(devices)) or None,
        pipelines=_pipelines(pipeline_names),
        startup=startup,
        repeats=repeats,
        runs=runs,
        threads=threads or get_threads(),
        timeout=timeout,
    )
    if out is not None:
        check_writable(out, folder=False)
    _finish(suite.run(plan, _say), out)


@app.command("ablation")
def ablation_(
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME,...", help=f"{', '.join(s.name for s in ablation.SCENES)}.")
    ] = "",
    size: Annotated[int, typer.Option(min=48, help="Pixels along each side of the ray-cast scenes.")] = 256,
    seeds: Annotated[int, typer.Option(min=1, help="How many of each ray-cast scene; errors are means over them.")] = 1,
    data: Annotated[
        Path, typer.Option(metavar="FOLDER", help="The real light fields; default: $LFGPU_DATA, or ../shared/data.")
    ] = ablation.DATA,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")] = None,
) -> None:
    """Leave out each ingredient of the preset `accurate`, one at a time, and print what that does to the errors."""
    plan = ablation.Plan(
        scenes=tuple(ablation.find(n) for n in _names(scene_names)) or ablation.SCENES,
        size=size,
        seeds=seeds,
        data=data,
        variants=ablation.VARIANTS,
    )
    if out is not None:
        check_writable(out, folder=False)
    _finish(ablation.run(plan, _say), out)


@app.command("accuracy")
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
    sheet: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Where the pictures of errors go.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")] = None,
) -> None:
    """Score presets on a population of light fields, with the range found and the true one, against a baseline."""
    where = [*(first or ()), *(folders or ())]
    made = _names(scene_names)
    if not where and not made:
        raise BenchmarkError("no light fields to score: give folders with --population, or --scenes of the package.")
    for name in made:
        population.made(name)
    if unknown := [name for name in _names(ranges) if name not in population.RANGES]:
        raise BenchmarkError(f"unknown range {unknown[0]!r}; there are {', '.join(population.RANGES)}.")
    for path in (out, sheet):
        if path is not None:
            check_writable(path, folder=False)
    old = results.load(baseline) if baseline != population.BASELINE or baseline.exists() else None
    pictures: list[population.Picture] = []
    run = population.run(where, _names(presets), _names(ranges), _say, pictures.append, made)
    if sheet is not None and pictures:
        error_sheet.write(pictures, sheet)
    _finish(run, out)
    if old is not None:
        show.table(tables.against(run, old))


@app.command("confidence")
def confidence_(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Light fields with truth, or folders.")],
    develop: Annotated[
        str, typer.Option("--develop", metavar="NAME,...", help="Scenes to fit on, besides the package's own.")
    ] = "",
    fit: Annotated[
        bool, typer.Option("--fit", help="Fit the weights and write them where the method has them.")
    ] = False,
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = "fast,accurate",
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.png", help="Where the diagram goes.")] = None,
) -> None:
    """What the confidence says against what is true, on the scenes that it was not fitted on; `--fit` fits it anew."""
    if out is not None:
        check_writable(out, folder=False)
    held = [name for name in population.light_fields(folders) if name not in _names(develop)]

    fitted = confidence.samples(folders, _names(develop), _names(presets), _say)
    if fit:
        fitted += confidence.own_samples(_names(presets), _say)
    weights = confidence.fit(fitted) if fit else confidence.NOW
    checked = confidence.samples(folders, held, _names(presets), _say)
    for table in confidence.tables(checked or fitted, weights):
        show.table(table)
    if out is not None:
        confidence.draw({"fitted on": fitted, "held out": checked}, weights, out)
    if fit:
        typer.echo(f"written: {confidence.write(weights, fitted)}: {weights.share}, {weights.spread}")


@app.command("rendering")
def rendering_(
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME,...", help=f"Default: {', '.join(rendering.SCENES)}.")
    ] = "",
    preset: Annotated[str, typer.Option(metavar="NAME", help="Of the maps of the views that are kept.")] = "accurate",
    every: Annotated[int, typer.Option(min=1, help="Render every so many of the views that are left out.")] = 1,
    data: Annotated[
        Path, typer.Option(metavar="FOLDER", help="The real light fields; default: $LFGPU_DATA, or ../shared/data.")
    ] = rendering.DATA,
) -> None:
    """Leave out every second row and column of views, render them from the rest, and print how near that comes."""
    rows = rendering.run(
        tuple(_names(scene_names)) or rendering.SCENES,
        data,
        preset=preset,
        every=every,
        say=_say,
    )
    typer.echo(rendering.markdown(rows), nl=False)


Device = Annotated[str | None, typer.Option(metavar="DEVICE", help="cpu or cuda:0; default: the best there is.")]
Out = Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")]


@app.command("files")
def files_(
    preset: Annotated[str, typer.Option(metavar="NAME", help="Of the maps.")] = "fast",
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
    rows, found = files.run(data, preset=preset, out=out, say=_say)
    typer.echo(files.markdown(rows, found))


@app.command("flicker")
def flicker_(
    case_name: Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")] = "5x5x128x128",
    frames: Annotated[int, typer.Option(min=6)] = 24,
    period: Annotated[int, typer.Option(min=1, help="Frames in which things go round; fewer is faster.")] = 240,
    noise: Annotated[float, typer.Option(help="Of the views, intensities being 0 to 1.")] = 0.01,
    seeds: Annotated[str, typer.Option(metavar="N,...", help="Of the scenes, a film for each.")] = "0,1,2,3",
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = "accurate,fast",
    pasts: Annotated[str, typer.Option(metavar="NAME,...", help="How the last map is used.")] = ",".join(flicker.PASTS),
    device: Device = None,
    out: Out = None,
) -> None:
    """How much maps of moving scenes change where nothing does, with and without the last map, and their errors."""
    if unknown := [name for name in _names(pasts) if name not in flicker.PASTS]:
        raise BenchmarkError(f"unknown past {unknown[0]!r}; there are {', '.join(flicker.PASTS)}.")
    case = cases.parse(case_name)
    film = moving.Film(case.grid, case.size, frames, period, noise)
    found, about = [], {**machine.about(), "film": asdict(film)}
    for seed in map(int, _names(seeds)):
        one = replace(film, seed=seed)
        for row in flicker.run(one, tuple(_names(presets)), tuple(_names(pasts)), device, _say):
            found.append(row)
            live.save(out, {**about, "rows": [asdict(row) for row in found]})  # as far as it is
    flicker.show(found)


@app.command("live")
def live_(
    case_names: Annotated[str, typer.Option("--cases", metavar="NAME,...")] = "7x7x375x375,9x9x512x512",
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = "accurate,fast",
    frames: Annotated[int, typer.Option(min=2, help="How many are cast; they are played to and fro.")] = 8,
    seconds: Annotated[float, typer.Option(min=0.1, help="How long each way is measured.")] = 10.0,
    budget: Annotated[float | None, typer.Option(metavar="MS", help="Of the device for a frame.")] = None,
    stages: Annotated[
        bool,
        typer.Option("--stages", help="Instead: time of each operation beside its limit by memory and arithmetic."),
    ] = False,
    device: Device = None,
    out: Out = None,
) -> None:
    """Frames a second and latency from a frame on the host to its map on the host, and errors of warm maps."""
    if stages:
        _live_stages(tuple(_names(case_names)), tuple(_names(presets)), device, out)
        return
    plan = live.Plan(tuple(_names(case_names)), tuple(_names(presets)), frames, seconds, budget, device)
    found, about = [], machine.about()
    for row in live.run(plan, _say):
        found.append(row)
        live.save(out, {**about, "rows": [asdict(row) for row in found]})  # as far as it is
    live.show(found)


def _live_stages(case_names: tuple[str, ...], presets: tuple[str, ...], device: str | None, out: Path | None) -> None:
    rates = live_stages.rates(device)
    rows, about = [], {**machine.about(), "rates": asdict(rates)}
    for name in case_names:
        case = cases.parse(name)
        film = moving.Film(case.grid, case.size, 1)
        for row in live_stages.run(name, film, presets, device, rates, _say):
            rows.append(row)
            found = [{**asdict(row), "limit": row.limit} for row in rows]
            live.save(out, {**about, "operations": found})  # as far as it is
    live_stages.show(rates, rows)


@app.command("ring")
def ring_(
    case_name: Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")] = "9x9x512x512",
    rate: Annotated[float, typer.Option(min=0.1, help="Frames a second.")] = 60.0,
    seconds: Annotated[float, typer.Option(min=0.1)] = 20.0,
    out: Out = None,
) -> None:
    """Frames of a producer in another process through shared memory; exits with 1 if one is torn."""
    case = cases.parse(case_name)
    found = ring.run(case.grid, case.size, rate, seconds)
    live.save(out, asdict(found))
    typer.echo(
        f"{found.read} frames of {found.frame_bytes / 1e6:.1f} MB read at {rate:g} a second, "
        f"{found.passed} passed over, {found.torn} torn, {found.repeated} copied again; "
        f"{found.late_p50:.2f} ms after they were published in the median, {found.late_p99:.2f} ms for 99 %."
    )
    if found.torn:
        raise typer.Exit(1)


@app.command("misalignment")
def misalignment_(
    scene_names: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENE...", help="Folders of light fields with truth, or scenes as boxes-11, NAME-SEED."
        ),
    ],
    arrays: Annotated[str, typer.Option(metavar="NAME,...", help="Which views are used.")] = ",".join(
        misalignment.ARRAYS
    ),
    disturbances: Annotated[
        list[str] | None,
        typer.Option("--misalign", metavar="WHAT", help="As of `lfgpu scene`; may be repeated. Default: five of them."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Draws of each disturbance.")] = 1,
    crop: Annotated[int, typer.Option(min=64, help="Longest side of the middle of the views that is used.")] = 512,
    preset: Annotated[str, typer.Option(metavar="NAME")] = "accurate",
    device: Device = None,
    append: Annotated[bool, typer.Option("--append", help="Add to the rows that the output has.")] = False,
    out: Out = None,
) -> None:
    """Errors of maps with cameras as they should be, misaligned, and lined up by `refine`, with the true range."""
    if out is not None:
        check_writable(out, folder=False)
    chosen = tuple(disturbances or misalignment.DISTURBANCES)
    plan = misalignment.Plan(tuple(scene_names), tuple(_names(arrays)), chosen, seeds, crop, preset, device)
    before = misalignment.load(out) if append and out is not None and out.exists() else []
    found, about = [], machine.about()
    for row in misalignment.run(plan, _say):
        found.append(row)
        live.save(out, {**about, "rows": [asdict(row) for row in (*before, *found)]})  # as far as it is
    misalignment.show(found)


@app.command("judge")
def judge_(
    scene_names: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENE...", help="Folders of light fields with truth, or scenes as boxes-11, NAME-SEED."
        ),
    ],
    draws: Annotated[int, typer.Option(min=1, help="Draws over all scenes.")] = 100,
    shift: Annotated[float, typer.Option(min=0.01, help="By how many pixels a view is moved.")] = 0.2,
    crop: Annotated[int, typer.Option(min=64, help="Side of the part of the views that is used.")] = 192,
    preset: Annotated[str, typer.Option(metavar="NAME")] = "fast",
    device: Device = None,
    out: Out = None,
) -> None:
    """Move one view in a random direction: is it found, and is nothing said without that?"""
    if out is not None:
        check_writable(out, folder=False)
    plan = judge.Plan(tuple(scene_names), draws, shift, crop, preset, device)
    about = {"machine": machine.describe(), "versions": machine.versions(), "commit": machine.commit()}
    found = []
    for draw in judge.run(plan, lambda what: typer.echo(what, err=True)):
        found.append(draw)
        rows = [asdict(one) for one in found]  # as far as it is
        live.save(out, {**about, "plan": judge.named(plan), "summary": judge.summary(found), "draws": rows})
    judge.show(found)


@app.command("rectify")
def rectify_(
    case_names: Annotated[str, typer.Option("--cases", metavar="NAME,...")] = "7x7x375x375,9x9x512x512",
    preset: Annotated[str, typer.Option(metavar="NAME", help="Of the frame that rectification is a part of.")] = (
        "accurate"
    ),
    backends: Annotated[str, typer.Option(metavar="NAME,...", help="Default: warp.")] = "warp",
    seconds: Annotated[float, typer.Option(min=0.01, help="For each measurement, at most.")] = 5.0,
    device: Device = None,
    out: Out = None,
) -> None:
    """What it costs to rectify raw frames on the device, by itself and as a part of a frame."""
    if out is not None:
        check_writable(out, folder=False)
    chosen = tuple(_known_backend(name) for name in _names(backends))
    some = tuple(cases.find(name) for name in _names(case_names))
    found, about = [], {**machine.about(), "rig": asdict(rectify.RIG)}
    for row in rectify.run(some, preset, chosen, device, _say, seconds=seconds):
        found.append(row)
        rows = [{**asdict(row), "added_ms": row.added_ms} for row in found]
        live.save(out, {**about, "rows": rows})  # as far as it is
    rectify.show(found)


@app.command("range")
def range_(
    case_names: Annotated[str, typer.Option("--cases", metavar="NAME,...")] = "9x9x512x512",
    preset: Annotated[str, typer.Option(metavar="NAME", help="Whose noise is measured.")] = "accurate",
    backends: Annotated[str, typer.Option(metavar="NAME,...", help="Default: warp.")] = "warp",
    seconds: Annotated[float, typer.Option(min=0.01, help="For each measurement, at most.")] = 5.0,
    device: Device = None,
    out: Out = None,
) -> None:
    """What it takes to find the disparity range and the noise before an estimate, from host to host."""
    if out is not None:
        check_writable(out, folder=False)
    chosen = tuple(_known_backend(name) for name in _names(backends))
    named = tuple(cases.find(name) for name in _names(case_names))
    found = measuring.run(named, preset, chosen, device, lambda what: typer.echo(what, err=True), seconds=seconds)
    about = {"machine": machine.describe(), "versions": machine.versions(), "commit": machine.commit()}
    live.save(out, {**about, "rows": [asdict(row) for row in found]})
    measuring.show(found)


@app.command("soak")
def soak_(
    frames: Annotated[int, typer.Option(min=1)] = 20_000,
    case_name: Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")] = "5x5x128x128",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "accurate",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    rectified: Annotated[
        bool, typer.Option("--rectify", help="Frames are raw pictures of a rig, rectified on the device.")
    ] = False,
    device: Device = None,
    out: Out = None,
) -> None:
    """Frames with random drop-outs, cuts and errors for a long time; exits with 1 if memory grows or one is lost."""
    if out is not None:
        check_writable(out, folder=False)
    case = cases.parse(case_name)
    plan = soak.Plan(frames, case.grid, case.size, preset, seed, device, rectified)
    about = {**machine.about(), "plan": asdict(plan)}
    for found in soak.run(plan, _say):
        live.save(out, {**about, **asdict(found)})  # as far as it is
    for line in found.lines():
        typer.echo(line)
    if found.problems:
        raise typer.Exit(1)


@app.command("native")
def native_(
    case_names: Annotated[str, typer.Option("--cases", metavar="NAME,...")] = "7x7x375x375",
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = "accurate,fast",
    threads: Annotated[str, typer.Option(metavar="N,...", help="Of the CPU.")] = "2,16",
    frames: Annotated[int, typer.Option(min=2, help="How many are cast.")] = 4,
    repeats: Annotated[int, typer.Option(min=1, help="How often they are played.")] = 5,
    device: Annotated[str, typer.Option(metavar="DEVICE", help="cpu or cuda:0.")] = "cpu",
    out: Out = None,
) -> None:
    """Time of a frame by the exported C++ program and by Python; exits with 1 if their maps differ."""
    if out is not None:
        check_writable(out, folder=False)
    counts = tuple(int(n) for n in _names(threads))
    plan = native.Plan(tuple(_names(case_names)), tuple(_names(presets)), frames, repeats, counts, device)
    found, about = [], {**machine.about(), "plan": asdict(plan)}
    for row in native.run(plan, _say):
        found.append(row)
        live.save(out, {**about, "rows": [asdict(row) for row in found]})  # as far as it is
    native.show(found)
    if not all(row.same_bits for row in found):
        raise typer.Exit(1)


@app.command("drift")
def drift_(
    hours: Annotated[float, typer.Option(min=0.001, help="Of simulated time.")] = 8.0,
    every: Annotated[float, typer.Option(min=0.1, help="Simulated seconds from look to look.")] = 10.0,
    amplitude: Annotated[float, typer.Option(min=0, max=0.5, help="How far gains go up and down, as a share.")] = 0.1,
    case_name: Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")] = "3x3x96x96",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "fast",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    device: Device = None,
    out: Out = None,
) -> None:
    """Cameras whose gains drift for hours of simulated time; exits with 1 if their tones do not follow."""
    if out is not None:
        check_writable(out, folder=False)
    case = cases.parse(case_name)
    plan = drift.Plan(hours, every, amplitude, case.grid, case.size, preset, seed, device)
    about = {**machine.about(), "plan": asdict(plan)}
    for found in drift.run(plan, _say):
        live.save(out, {**about, **found.summary()})  # as far as it is
    drift.show(found)
    if found.problems:
        raise typer.Exit(1)


@app.command("scaling")
def scaling_(
    case_names: Annotated[str, typer.Option("--cases", metavar="NAME,...")] = "7x7x375x375,9x9x512x512",
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = "fast,accurate",
    devices: Annotated[str, typer.Option(metavar="NAME,...", help="Default: all GPUs, or the CPU.")] = "",
    counts: Annotated[str, typer.Option(metavar="N,...", help="On how many of them; default: 1, 2, 4 and all.")] = "",
    how: Annotated[str, typer.Option(metavar="KIND", help=f"{' or '.join(scaling.KINDS)}, one for each device.")] = (
        scaling.KINDS[0]
    ),
    seconds: Annotated[float, typer.Option(min=0, help="For each measurement.")] = 5,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")] = None,
) -> None:
    """Measure light fields in a second on 1, 2, 4 .. GPUs of this machine."""
    names = tuple("cuda:0" if n == "cuda" else n for n in _names(devices)) or scaling.devices_here()
    wanted = tuple(int(n) for n in _names(counts)) or tuple(
        sorted({1, *(n for n in (2, 4) if n <= len(names)), len(names)})
    )
    if out is not None:
        check_writable(out, folder=False)
    plan = scaling.Plan(
        tuple(cases.find(n) for n in _names(case_names)), tuple(_names(presets)), names, wanted, how, seconds
    )
    rows = scaling.run(plan, _say)
    if out is not None:
        scaling.save(rows, out)
    typer.echo(scaling.table(rows), nl=False)


@app.command("batches")
def batches_(
    case_name: Annotated[str, typer.Option("--case", metavar="NAME")] = "9x9x512x512",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "fast",
    kinds: Annotated[str, typer.Option(metavar="KIND,...", help="What the items are.")] = ",".join(batches.KINDS),
    counts: Annotated[str, typer.Option(metavar="N,...", help="On how many GPUs; default: 1, 2, 4 and all.")] = "",
    items: Annotated[int, typer.Option(min=10, help="For each worker.")] = 100,
    per_gpu: Annotated[str, typer.Option(metavar="N,...", help="Workers for each GPU.")] = "1",
    threads: Annotated[int, typer.Option(min=1, help="Of the CPU for each worker.")] = 4,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")] = None,
) -> None:
    """Measure the items in a second that `lfgpu batch` does on 1, 2, 4 .. GPUs of this machine, and where they wait."""
    there = len(scaling.devices_here())
    wanted = tuple(int(n) for n in _names(counts)) or tuple(sorted({1, *(n for n in (2, 4) if n <= there), there}))
    if out is not None:
        check_writable(out, folder=False)
    rows = batches.run(
        cases.find(case_name),
        preset,
        _names(kinds),
        [(gpus, int(n)) for n in _names(per_gpu) for gpus in wanted],
        items=items,
        threads=threads,
        say=_say,
    )
    if out is not None:
        scaling.save(rows, out)
    typer.echo(batches.table(rows), nl=False)


@app.command("tiles")
def tiles_(
    case_name: Annotated[str, typer.Option("--case", metavar="NAME")] = "17x17x960x1280",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "accurate",
    device: Annotated[str | None, typer.Option(metavar="NAME", help="Default: all GPUs, or the CPU.")] = None,
    max_memory: Annotated[
        str, typer.Option(metavar="SIZE,...", help='One estimate for each; "none" for no limit and no tiles.')
    ] = "8GiB",
) -> None:
    """Estimate a light field of planes within a given memory; say what it took in time and memory."""
    limits = [None if name == "none" else name for name in _names(max_memory)]
    for found in tiles.measure(cases.find(case_name), preset, device, limits):
        for name, value in found.items():
            typer.echo(f"{name:<12} {value}")


@app.command("tile-differences")
def tile_differences_(
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = "fast,accurate",
    out: Out = None,
) -> None:
    """How far maps in 2 x 2 tiles are from those in one piece, after each stage."""
    if out is not None:
        check_writable(out, folder=False)
    rows = tile_differences.run(_names(presets))
    live.save(out, {**tile_differences.about(), "rows": rows})
    for row in rows:
        typer.echo(", ".join(f"{name} {value}" for name, value in row.items()))


@app.command("viewer")
def viewer_(
    case_name: Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")] = "17x17x960x1280",
    times: Annotated[int, typer.Option(min=1, help="Requests after the first one; their median is given.")] = 5,
    out: Out = None,
) -> None:
    """What each kind of picture costs the server of `lfgpu view`: CPU time and wall time."""
    if out is not None:
        check_writable(out, folder=False)
    costs: list[viewer.Cost] = []
    about = machine.about()
    for cost in viewer.run(cases.parse(case_name), times, _say):
        costs.append(cost)
        live.save(out, {**about, "case": case_name, "pictures": [asdict(one) for one in costs]})  # as far as it is
    viewer.show(costs)


@app.command()
def table(files: Files) -> None:
    """Print results as Markdown, a section for each machine."""
    typer.echo("\n".join(show.markdown(run) for run in merge.merged(map(results.load, files))), nl=False)


@app.command("plot")
def plot_(
    files: Files,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help=".png, .svg or .pdf")],
) -> None:
    """Draw time against the size of the light field."""
    plot.write(merge.merged(map(results.load, files)), out)


@app.command("compare")
def compare_(
    old: Annotated[Path, typer.Argument(metavar="OLD.json")],
    new: Annotated[Path, typer.Argument(metavar="NEW.json")],
    threshold: Annotated[float, typer.Option(min=0, help="Percent.")] = 10,
) -> None:
    """Say what got slower, faster or worse; exit with 1 if something got slower or worse."""
    found = compare.compare(results.load(old), results.load(new), threshold / 100)
    for warning in found.warnings:
        typer.echo(f"warning: {warning}", err=True)
    for title, lines in compare.sections(found):
        for line in lines:
            typer.echo(f"{title}: {line}")
    typer.echo(
        f"{found.compared} compared, {len(found.slower)} slower, {len(found.faster)} faster, {len(found.worse)} worse."
    )
    if found.fails:
        raise typer.Exit(1)


@app.command("gallery")
def gallery_(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.png", help="Where the picture goes.")] = Path(
        "docs/gallery.png"
    ),
) -> None:
    """Draw the gallery of the README: three scenes of the package, their disparity, its error, and points in space."""
    check_writable(out, folder=False)
    for line in gallery.write(out):
        typer.echo(line)


@app.command("gpu-parity")
def gpu_parity_(
    backend: Annotated[str, typer.Option(metavar="NAME")] = "warp",
    device: Annotated[str, typer.Option(metavar="DEVICE")] = "cuda:0",
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")] = (
        gpu_parity.RESULT
    ),
) -> None:
    """Test every operation on a GPU against the reference; the file names the commit. Exits with 1 on failures."""
    check_writable(out, folder=False)
    for found in gpu_parity.run(_known_backend(backend), device, _say):
        gpu_parity.save(found, out)  # as far as it is
    if not found["passed"]:
        raise BenchmarkError(f"nothing could be tested on {backend} {device}: is the device there?")
    typer.echo(f"{found['passed']} passed, {found['skipped']} skipped, {len(found['failed'])} failed: {out}")
    if found["failed"]:
        raise typer.Exit(1)


@app.command("paper")
def paper_(
    names: Annotated[
        str, typer.Option("--experiments", metavar="NAME,...", help=f"{', '.join(e.name for e in paper.EXPERIMENTS)}.")
    ] = "",
    presets: Annotated[str, typer.Option(metavar="NAME,...")] = ",".join(paper.PRESETS),
    data: Annotated[
        Path, typer.Option(metavar="FOLDER", help="The real light fields; default: $LFGPU_DATA, or ../shared/data.")
    ] = ablation.DATA,
    pictures: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Where pictures go: docs/paper.")] = None,
    out: Out = None,
) -> None:
    """Repeat the paper's experiments, and hold the kernels against its printed equations."""
    known = {experiment.name for experiment in paper.EXPERIMENTS}
    if unknown := [name for name in _names(names) if name not in known]:
        raise BenchmarkError(f"unknown experiment {unknown[0]!r}; there are {', '.join(sorted(known))}.")
    if out is not None:
        check_writable(out, folder=False)
    found = paper.run(data, _names(names), pictures, _say, _names(presets))
    if out is not None:
        results.save(found, out)
    for rows in (paper.forms(found), paper.experiments(found)):
        show.table(tables.Table("", rows[0], 1, rows[1:]))


@app.command("figures")
def figures_(
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit with 1 if a page differs.")] = False,
    list_: Annotated[bool, typer.Option("--list", help="Write nothing; print what each figure comes from.")] = False,
) -> None:
    """Write the figures of README, docs and benchmarks anew from the files in benchmarks/results."""
    if not (check or list_):
        for page in figures.write():
            typer.echo(f"written: {page.relative_to(figures.ROOT)}")
        return
    found = [mark for page in figures.pages() for mark in figures.marks(page)]
    differing = [mark for mark in found if mark.found != mark.wanted]
    for line in figures.listing(found if list_ else differing):
        typer.echo(line)
    if check and differing:
        raise BenchmarkError(f"{len(differing)} figures differ from their files: run python -m benchmarks figures.")


def _finish(run: results.Run, out: Path | None) -> None:
    """Save and show a run; BenchmarkError if there is nothing in it."""
    if out is not None:
        results.save(run, out)
    show.terminal(run)
    if not any(record.seconds for record in run.records):
        raise BenchmarkError("nothing could be measured, see above.")


def _say(what: str) -> None:
    typer.echo(what, err=True)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _operations(text: str) -> tuple[operations.Operation, ...]:
    if text == "none":
        return ()
    return tuple(operations.find(name) for name in _names(text)) or operations.OPERATIONS


def _pipelines(text: str) -> tuple[str, ...]:
    names = () if text == "none" else tuple(_names(text)) or pipelines.NAMES
    for name in names:
        if name not in pipelines.NAMES:
            raise BenchmarkError(f"unknown pipeline {name!r}; there are {', '.join(pipelines.NAMES)}.")
    return names


def _known_backend(name: str) -> str:
    if name not in list_backends():
        raise BenchmarkError(f"unknown backend {name!r}; there are {', '.join(list_backends())}.")
    return name
