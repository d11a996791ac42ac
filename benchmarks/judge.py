"""Whether the judge finds a view that was moved, and in which direction; and whether it is silent where all is well."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import ndimage

from benchmarks.errors import BenchmarkError
from benchmarks.misalignment import recording
from lfgpu import LightField, estimate_depth, explain
from lfgpu.calibration import judged

Say = Callable[[str], None]
_TURN = 22.5  # degrees by which the direction that is found may differ: half the way between two of eight directions
_NAMED = re.compile(r"the view at row (\d+), column (\d+) is [^;:]* where it should be")


@dataclass(frozen=True)
class Plan:
    """Draws are dealt to the scenes in turn; `crop` is the side of the part of the views that is looked at, pixels."""

    scenes: tuple[str, ...]
    draws: int
    shift: float
    crop: int
    preset: str
    device: str | None


@dataclass(frozen=True)
class Draw:
    """One view moved, and what was said before and after.

    `corner` is the first row and column of the part of the views; `moved` and `found` are (x, y) in pixels, right and
    down. `quick` says the same of the quick look that `lfgpu depth` takes.
    """

    scene: str
    seed: int
    views: int
    corner: tuple[int, int]
    view: tuple[int, int]
    """(row, column)"""
    moved: tuple[float, float]
    found: tuple[float, float]
    findings: tuple[str, ...]
    is_found: bool
    quick: tuple[str, ...]
    is_found_quickly: bool
    false_alarms: tuple[str, ...]
    """Of the quick look at the same part of the undisturbed views."""


def run(plan: Plan, say: Say) -> Iterator[Draw]:
    """All draws, one after the other: a part of the views, one of them, and a direction, each at random."""
    scenes = [recording(scene)(None) for scene in plan.scenes]
    for seed in range(plan.draws):
        place = seed % len(scenes)
        say(f"{plan.scenes[place]}, draw {seed}")
        yield _drawn(Path(plan.scenes[place]).name, scenes[place], seed, plan)


def _drawn(scene: str, lf: LightField, seed: int, plan: Plan) -> Draw:
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
    result = estimate_depth(wrong, config=plan.preset, device=plan.device)  # type: ignore[arg-type]
    explanation = explain(wrong, result, device=plan.device)
    quick = judged(wrong, result, device=plan.device).remarks
    undisturbed = estimate_depth(right, config=plan.preset, device=plan.device)  # type: ignore[arg-type]
    found = explanation.shift[index]
    turn = np.angle(complex(*found) / complex(*moved), deg=True)
    return Draw(
        scene,
        seed,
        len(lf.views),
        (top, left),
        (row, column),
        (float(moved[0]), float(moved[1])),
        (float(found[0]), float(found[1])),
        explanation.findings,
        names(explanation.findings, (row, column)) and bool(abs(turn) <= _TURN),
        quick,
        names(quick, (row, column)),
        judged(right, undisturbed, device=plan.device).remarks,
    )


def shifted(lf: LightField, index: int, by: np.ndarray) -> np.ndarray:
    """A view [y, x, c] as it is stored that shows everything by (x, y) pixels farther right and down."""
    image = lf.image(index)
    planes = [
        ndimage.shift(image[..., c], by[::-1], order=5, mode="mirror", output=np.float32) for c in range(lf.channels)
    ]
    view = np.clip(np.stack(planes, axis=-1), 0, 1)
    return view if lf.views.dtype == np.float32 else np.rint(view / lf.scale).astype(lf.views.dtype)


def names(findings: tuple[str, ...], view: tuple[int, int]) -> bool:
    """Whether one finding is said, and says of that view, and of no other, that it is moved."""
    if len(findings) != 1:
        return False
    return [tuple(map(int, found)) for found in _NAMED.findall(findings[0])] == [view] and "more" not in findings[0]


def named(plan: Plan) -> dict[str, Any]:
    """The plan with the names of scenes instead of their folders, for JSON."""
    return asdict(replace(plan, scenes=tuple(Path(scene).name for scene in plan.scenes)))


def summary(draws: list[Draw]) -> dict[str, int | float]:
    """Counts, and the largest distance of a shift found from the true one, pixels."""
    off = [float(np.hypot(d.found[0] - d.moved[0], d.found[1] - d.moved[1])) for d in draws]
    return {
        "draws": len(draws),
        "found": sum(d.is_found for d in draws),
        "found_quickly": sum(d.is_found_quickly for d in draws),
        "false_alarms": sum(bool(d.false_alarms) for d in draws),
        "farthest_px": max(off),
        "median_px": float(np.median(off)),
    }


def show(draws: list[Draw]) -> None:
    """A table with a row for each scene."""
    table = Table()
    for name in ("scene", "draws", "found", "by the quick look", "false alarms", "shift off by, px", "at most"):
        table.add_column(name, justify="left" if name == "scene" else "right")
    groups = {scene: [d for d in draws if d.scene == scene] for scene in dict.fromkeys(d.scene for d in draws)}
    for scene, some in {**groups, "all": draws}.items():
        found = summary(some)
        counts = (str(found[k]) for k in ("draws", "found", "found_quickly", "false_alarms"))
        table.add_row(scene, *counts, *(f"{found[k]:.3f}" for k in ("median_px", "farthest_px")))
    Console(width=120).print(table)
