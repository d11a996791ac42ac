"""Streams: moving scenes, frame rates, shared memory, drift, long runs, other programs."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from benchmarks import cases, drift, flicker, live, live_stages, machine, moving, native, ring, soak
from benchmarks.cli.options import CaseNames, CaseSize, Device, Out, Presets, check_known, listed
from benchmarks.cli.outputs import check_out, collected, say


def flicker_(
    case_name: CaseSize = "5x5x128x128",
    frames: Annotated[int, typer.Option(min=6)] = 24,
    period: Annotated[int, typer.Option(min=1, help="Frames in which things go round; fewer is faster.")] = 240,
    noise: Annotated[float, typer.Option(help="Noise of the views; intensities are 0 to 1.")] = 0.01,
    seeds: Annotated[str, typer.Option(metavar="N,...", help="Seeds of the scenes; one film for each.")] = "0,1,2,3",
    presets: Presets = "accurate,fast",
    pasts: Annotated[str, typer.Option(metavar="NAME,...", help="How the last map is used.")] = ",".join(flicker.PASTS),
    device: Device = None,
    out: Out = None,
) -> None:
    """How much maps of moving scenes change where nothing does, with and without the last map, and their errors."""
    check_known(listed(pasts), "past", flicker.PASTS)
    case = cases.parse(case_name)
    film = moving.Film(case.grid, case.size, frames, period, noise)
    rows = (
        row
        for seed in map(int, listed(seeds))
        for row in flicker.run(replace(film, seed=seed), tuple(listed(presets)), tuple(listed(pasts)), device, say)
    )
    flicker.show(collected(rows, out, {**machine.about(), "film": asdict(film)}))


def live_(
    case_names: CaseNames = "7x7x375x375,9x9x512x512",
    presets: Presets = "accurate,fast",
    frames: Annotated[int, typer.Option(min=2, help="Number of rendered frames; they are played to and fro.")] = 8,
    seconds: Annotated[float, typer.Option(min=0.1, help="How long each way is measured.")] = 10.0,
    budget: Annotated[float | None, typer.Option(metavar="MS", help="Largest time of the device for a frame.")] = None,
    stages: Annotated[
        bool,
        typer.Option("--stages", help="Instead: time of each operation beside its limit by memory and arithmetic."),
    ] = False,
    device: Device = None,
    out: Out = None,
) -> None:
    """Frames a second and latency from a frame on the host to its map on the host, and errors of warm maps."""
    if stages:
        _live_stages(tuple(listed(case_names)), tuple(listed(presets)), device, out)
        return
    plan = live.Plan(tuple(listed(case_names)), tuple(listed(presets)), frames, seconds, budget, device)
    live.show(collected(live.run(plan, say), out, machine.about()))


def _live_stages(case_names: tuple[str, ...], presets: tuple[str, ...], device: str | None, out: Path | None) -> None:
    rates = live_stages.rates(device)
    films = {name: moving.Film(case.grid, case.size, 1) for name in case_names for case in (cases.parse(name),)}
    rows = collected(
        (row for name in case_names for row in live_stages.run(name, films[name], presets, device, rates, say)),
        out,
        {**machine.about(), "rates": asdict(rates)},
        key="operations",
        as_json=lambda row: {**asdict(row), "limit": row.limit},
    )
    live_stages.show(rates, rows)


def ring_(
    case_name: CaseSize = "9x9x512x512",
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


def soak_(
    frames: Annotated[int, typer.Option(min=1)] = 20_000,
    case_name: CaseSize = "5x5x128x128",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "accurate",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    rectified: Annotated[
        bool, typer.Option("--rectify", help="Frames are raw pictures of a rig, rectified on the device.")
    ] = False,
    device: Device = None,
    out: Out = None,
) -> None:
    """Frames with random drop-outs, cuts and errors for a long time; exits with 1 if memory grows or one is lost."""
    check_out(out)
    case = cases.parse(case_name)
    plan = soak.Plan(frames, case.grid, case.size, preset, seed, device, rectified)
    about = {**machine.about(), "plan": asdict(plan)}
    for found in soak.run(plan, say):
        live.save(out, {**about, **asdict(found)})  # as far as it is
    for line in found.lines():
        typer.echo(line)
    if found.problems:
        raise typer.Exit(1)


def native_(
    case_names: CaseNames = "7x7x375x375",
    presets: Presets = "accurate,fast",
    threads: Annotated[str, typer.Option(metavar="N,...", help="Numbers of CPU threads.")] = "2,16",
    frames: Annotated[int, typer.Option(min=2, help="Number of rendered frames.")] = 4,
    repeats: Annotated[int, typer.Option(min=1, help="How often they are played.")] = 5,
    device: Annotated[str, typer.Option(metavar="DEVICE", help="cpu or cuda:0.")] = "cpu",
    out: Out = None,
) -> None:
    """Time of a frame by the exported C++ program and by Python; exits with 1 if their maps differ."""
    check_out(out)
    counts = tuple(int(n) for n in listed(threads))
    plan = native.Plan(tuple(listed(case_names)), tuple(listed(presets)), frames, repeats, counts, device)
    found = collected(native.run(plan, say), out, {**machine.about(), "plan": asdict(plan)})
    native.show(found)
    if not all(row.same_bits for row in found):
        raise typer.Exit(1)


def drift_(
    hours: Annotated[float, typer.Option(min=0.001, help="Simulated hours.")] = 8.0,
    every: Annotated[float, typer.Option(min=0.1, help="Simulated seconds from look to look.")] = 10.0,
    amplitude: Annotated[float, typer.Option(min=0, max=0.5, help="How far gains go up and down, as a share.")] = 0.1,
    case_name: CaseSize = "3x3x96x96",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "fast",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    device: Device = None,
    out: Out = None,
) -> None:
    """Cameras whose gains drift for hours of simulated time; exits with 1 if their tones do not follow."""
    check_out(out)
    case = cases.parse(case_name)
    plan = drift.Plan(hours, every, amplitude, case.grid, case.size, preset, seed, device)
    about = {**machine.about(), "plan": asdict(plan)}
    for found in drift.run(plan, say):
        live.save(out, {**about, **found.summary()})  # as far as it is
    drift.show(found)
    if found.problems:
        raise typer.Exit(1)
