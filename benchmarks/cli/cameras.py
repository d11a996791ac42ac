"""Cameras that are not as they should be: lined up, found, rectified."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from benchmarks import cases, judge, live, machine, misalignment, rectify
from benchmarks.cli.options import Backends, CaseNames, Device, Out, Scenes, Seconds, known_backend, listed
from benchmarks.cli.outputs import check_out, collected, say


def misalignment_(
    scene_names: Scenes,
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
    check_out(out)
    chosen = tuple(disturbances or misalignment.DISTURBANCES)
    plan = misalignment.Plan(tuple(scene_names), tuple(listed(arrays)), chosen, seeds, crop, preset, device)
    before = misalignment.load(out) if append and out is not None and out.exists() else []
    misalignment.show(collected(misalignment.run(plan, say), out, machine.about(), before=before))


def judge_(
    scene_names: Scenes,
    draws: Annotated[int, typer.Option(min=1, help="Draws over all scenes.")] = 100,
    first: Annotated[int, typer.Option(min=0, help="Seed of the first draw.")] = 0,
    undisturbed: Annotated[
        list[str] | None,
        typer.Option(metavar="LIGHT_FIELD", help="Also look at this one, with nothing moved; may be repeated."),
    ] = None,
    noises: Annotated[int, typer.Option(min=0, help="How often noise is added to each of these.")] = 3,
    shift: Annotated[float, typer.Option(min=0.01, help="By how many pixels a view is moved.")] = 0.2,
    crop: Annotated[int, typer.Option(min=64, help="Side of the part of the views that is used.")] = 192,
    preset: Annotated[str, typer.Option(metavar="NAME")] = "fast",
    device: Device = None,
    out: Out = None,
) -> None:
    """Move one view in a random direction: is it found, and is nothing said without that?"""
    check_out(out)
    plan = judge.Plan(tuple(scene_names), draws, first, tuple(undisturbed or ()), noises, shift, crop, preset, device)
    about = machine.about()
    found: list[judge.Draw] = []
    silences: list[judge.Silence] = []

    def save() -> None:  # as far as it is
        summary = {**(judge.summary(found) if found else {}), **judge.alarms(silences)}
        rows = {"draws": [asdict(one) for one in found], "undisturbed": [asdict(one) for one in silences]}
        live.save(out, {**about, "plan": judge.named(plan), "summary": summary, **rows})

    for silence in judge.undisturbed(plan, say):
        silences.append(silence)
        save()
    for draw in judge.run(plan, say):
        found.append(draw)
        save()
    judge.show(found, silences)


def rectify_(
    case_names: CaseNames = "7x7x375x375,9x9x512x512",
    preset: Annotated[
        str, typer.Option(metavar="NAME", help="Preset of the frame that includes the rectification.")
    ] = ("accurate"),
    backends: Backends = "warp",
    seconds: Seconds = 5.0,
    device: Device = None,
    out: Out = None,
) -> None:
    """What it costs to rectify raw frames on the device, by itself and as a part of a frame."""
    check_out(out)
    chosen = tuple(known_backend(name) for name in listed(backends))
    some = tuple(cases.find(name) for name in listed(case_names))
    rows = rectify.run(some, preset, chosen, device, say, seconds=seconds)
    about = {**machine.about(), "rig": asdict(rectify.RIG)}
    rectify.show(collected(rows, out, about, as_json=lambda row: {**asdict(row), "added_ms": row.added_ms}))
