"""Share of moved views that the judge of cameras finds, with their direction; and false alarms where all is well."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy import ndimage

from benchmarks import machine
from benchmarks.errors import BenchmarkError
from benchmarks.misalignment import recording
from benchmarks.options import DeviceName, Out, Preset, Row, Scenes, check_out, save, say
from benchmarks.tables import Table
from lfgpu import DepthResult, LightField, estimate_depth, explain, read
from lfgpu.pipelines.verdict import judged

_TURN = 22.5  # degrees by which the direction that is found may differ: half the way between two of eight directions
_NOISE = 0.005, 0.03  # standard deviation that is added, at least and at most
_NAMED = re.compile(r"the view at row (\d+), column (\d+) is [^;:]* where it should be")


@dataclass(frozen=True)
class Plan:
    """Draws are dealt to the scenes in turn, seeds are counted from `first`; `crop` is the longest side of the part of
    the views that is looked at, pixels. In `undisturbed` light fields nothing is moved: a part of each is looked at as
    it is, and `noises` times with noise added."""

    scenes: tuple[str, ...]
    draws: int
    first: int
    undisturbed: tuple[str, ...]
    noises: int
    shift: float
    crop: int
    preset: str
    device: str | None


def command(
    scene_names: Scenes,
    draws: Annotated[int, typer.Option(min=1, help="Draws over all scenes.")] = 100,
    first: Annotated[int, typer.Option(min=0, help="Seed of the first draw.")] = 0,
    undisturbed: Annotated[
        list[str] | None,
        typer.Option(metavar="LIGHT_FIELD", help="Also look at this one, with nothing moved; may be repeated."),
    ] = None,
    noises: Annotated[int, typer.Option(min=0, help="Number of noisy copies of each of these.")] = 3,
    shift: Annotated[float, typer.Option(min=0.01, help="By how many pixels a view is moved.")] = 0.2,
    crop: Annotated[int, typer.Option(min=64, help="Side of the part of the views that is used.")] = 192,
    preset: Preset = "fast",
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Move one view in a random direction, and see whether it is found, and whether nothing is said without that."""
    check_out(out)
    plan = Plan(tuple(scene_names), draws, first, tuple(undisturbed or ()), noises, shift, crop, preset, device)
    about = {**machine.about("judge"), "plan": named(plan)}
    found: list[Row] = []
    silences: list[Row] = []
    for one in chain(_silences(plan), _draws(plan)):
        (found if "moved" in one else silences).append(one)
        counts = {**(summary(found) if found else {}), **alarms(silences)}
        save(out, {**about, "summary": counts, "draws": found, "undisturbed": silences})
    table(found).show()
    if silences:
        said = alarms(silences)
        typer.echo(
            f"{said['undisturbed']} light fields with nothing moved, {said['with_noise']} of them with noise added: "
            f"{said['alarms']} false alarms of the check, {said['alarms_quickly']} of the quick look."
        )


def _silences(plan: Plan) -> Iterator[Row]:
    """Look at a part of each light field in which nothing was moved, as it is and with noise.

    `noise` is the standard deviation that was added, `findings` and `quick` what was said all the same.
    """
    for scene in plan.undisturbed:
        lf = light_field(scene)
        for seed in range(plan.first, plan.first + plan.noises + 1):
            say(f"{scene}, nothing moved, draw {seed}")
            yield _left_alone(Path(scene).name, lf, seed, plan)


def light_field(scene: str) -> LightField:
    """Read any light field, or make a scene of the package by name and seed, "boxes-11"."""
    return read(Path(scene), allow_missing=True) if Path(scene).exists() else recording(scene)(None)


def _left_alone(scene: str, lf: LightField, seed: int, plan: Plan) -> Row:
    random = np.random.default_rng(seed)
    sides = [min(side, plan.crop) for side in lf.size]
    top, left = (int(random.integers(0, whole - side + 1)) for whole, side in zip(lf.size, sides, strict=True))
    part = lf.crop(slice(top, top + sides[0]), slice(left, left + sides[1]))
    noise = float(random.uniform(*_NOISE)) if seed > plan.first else 0.0
    if noise:
        images = np.stack([part.image(n) for n in range(len(part.views))])
        images += random.normal(0, noise, images.shape).astype(np.float32)
        views = np.rint(255 * np.clip(images, 0, 1)).astype(np.uint8)  # as cameras record it
        part = replace(part, views=views, files=())
    result, quick = _quickly(part, plan)
    findings = explain(part, result, device=plan.device).findings
    what = {"scene": scene, "seed": seed, "views": len(lf.views), "corner": (top, left), "noise": noise}
    return {**what, "findings": findings, "quick": quick}


def _quickly(lf: LightField, plan: Plan) -> tuple[DepthResult, tuple[str, ...]]:
    """Estimate a map; return it, and what the quick look that `lfgpu depth` takes says of the cameras."""
    result = estimate_depth(lf, config=plan.preset, device=plan.device, check_cameras=False)  # type: ignore[arg-type]
    return result, judged(lf, result, device=plan.device).remarks


def _draws(plan: Plan) -> Iterator[Row]:
    """Draw a part of the views, one of them and a direction, and see whether it is found; one after the other.

    `corner` is the first row and column of the part of the views, `view` the (row, column) of the one that is moved;
    `moved` and `found` are (x, y) in pixels, right and down. `quick` says the same of the quick look that `lfgpu depth`
    takes, `false_alarms` what it says of the same part of the undisturbed views.
    """
    scenes = [recording(scene)(None) for scene in plan.scenes]
    for seed in range(plan.first, plan.first + plan.draws):
        place = seed % len(scenes)
        say(f"{plan.scenes[place]}, draw {seed}")
        yield _drawn(Path(plan.scenes[place]).name, scenes[place], seed, plan)


def _drawn(scene: str, lf: LightField, seed: int, plan: Plan) -> Row:
    random = np.random.default_rng(seed)
    height, width = lf.size
    if min(height, width) < plan.crop:
        raise BenchmarkError(f"{scene} has views of {height} x {width}; --crop must not be more.")
    top, left = (int(random.integers(0, side - plan.crop + 1)) for side in (height, width))
    index, angle = int(random.integers(len(lf.views))), float(random.uniform(0, 2 * np.pi))
    moved = plan.shift * np.array([np.cos(angle), np.sin(angle)])
    views = lf.views.copy()
    views[index] = shifted(lf, index, moved)
    window = slice(top, top + plan.crop), slice(left, left + plan.crop)
    right, wrong = lf.crop(*window), replace(lf, views=views, files=()).crop(*window)
    column, row = (int(k) for k in lf.positions[index])
    result, quick = _quickly(wrong, plan)
    explanation = explain(wrong, result, device=plan.device)
    found = explanation.shift[index]
    turn = np.angle(complex(*found) / complex(*moved), deg=True)
    return {
        **{"scene": scene, "seed": seed, "views": len(lf.views), "corner": (top, left), "view": (row, column)},
        **{"moved": tuple(map(float, moved)), "found": tuple(map(float, found)), "findings": explanation.findings},
        "is_found": names(explanation.findings, (row, column)) and bool(abs(turn) <= _TURN),
        "quick": quick,
        "is_found_quickly": names(quick, (row, column)),
        "false_alarms": _quickly(right, plan)[1],
    }


def shifted(lf: LightField, index: int, by: np.ndarray) -> np.ndarray:
    """Move a view, [y, x, c] as it is stored, by (x, y) pixels to the right and down."""
    image = lf.image(index)
    planes = [
        ndimage.shift(image[..., c], by[::-1], order=5, mode="mirror", output=np.float32) for c in range(lf.channels)
    ]
    view = np.clip(np.stack(planes, axis=-1), 0, 1)
    return view if lf.views.dtype == np.float32 else np.rint(view / lf.scale).astype(lf.views.dtype)


def names(findings: tuple[str, ...], view: tuple[int, int]) -> bool:
    """Return whether one finding is said, and says of that view, and of no other, that it is moved."""
    if len(findings) != 1:
        return False
    return [tuple(map(int, found)) for found in _NAMED.findall(findings[0])] == [view] and "more" not in findings[0]


def named(plan: Plan) -> dict[str, Any]:
    """Return the plan with the names of scenes instead of their folders, for JSON."""
    scenes, still = (tuple(Path(scene).name for scene in some) for some in (plan.scenes, plan.undisturbed))
    return asdict(replace(plan, scenes=scenes, undisturbed=still))


def alarms(silences: list[Row]) -> dict[str, int]:
    """Count how often something was said where nothing was moved."""
    return {
        "undisturbed": len(silences),
        "with_noise": sum(s["noise"] > 0 for s in silences),
        "alarms": sum(bool(s["findings"]) for s in silences),
        "alarms_quickly": sum(bool(s["quick"]) for s in silences),
    }


def summary(draws: Sequence[Row]) -> dict[str, int | float]:
    """Count, and measure the largest distance of a shift found from the true one, pixels."""
    off = [math.dist(d["found"], d["moved"]) for d in draws]
    counted = {"found": "is_found", "found_quickly": "is_found_quickly", "false_alarms": "false_alarms"}
    counts = {name: sum(bool(d[key]) for d in draws) for name, key in counted.items()}
    return {"draws": len(draws), **counts, "farthest_px": max(off), "median_px": float(np.median(off))}


def table(draws: Sequence[Mapping[str, Any]]) -> Table:
    """Make a table from the draws of a file, with a row for each scene."""
    groups = [(f"`{d['scene']}`", [e for e in draws if e["scene"] == d["scene"]]) for d in draws]

    def count(key: str) -> Callable[[Any], str]:
        return lambda group: str(sum(bool(draw[key]) for draw in group[1]))

    columns: dict[str, Callable[[Any], str]] = {
        "scene": lambda group: group[0],
        "draws": lambda group: str(len(group[1])),
        "found by `check`": count("is_found"),
        "by the quick look": count("is_found_quickly"),
        "false alarms": count("false_alarms"),
        "shift off by at most, px": lambda group: f"{max(math.dist(d['found'], d['moved']) for d in group[1]):.3f}",
    }
    return Table.of("", 1, [*dict(groups).items(), *([("all", draws)] if draws else [])], columns)
