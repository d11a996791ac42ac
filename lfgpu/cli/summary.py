"""Summaries that `lfgpu depth` and `lfgpu demo` print at the end."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfgpu.cli import console as shown
from lfgpu.data.summary import view_at
from lfgpu.errors import LightFieldError
from lfgpu.reports import facts

if TYPE_CHECKING:
    from rich.console import Console

    from lfgpu.data import DepthResult, LightField
    from lfgpu.metrics import Metrics


def show_input(console: Console, lf: LightField) -> None:
    """Print the facts about the light field."""
    shown.heading(console, lf.name)
    shown.lines(
        console,
        [
            ("views used", facts.views(lf)),
            ("size", facts.size(lf)),
            ("reference", facts.reference(lf)),
            *(("note", note) for note in lf.notes),
        ],
    )


def show_result(console: Console, result: DepthResult, *, range_given: bool) -> None:
    """Print the range of the map, the time, and why the solver stopped."""
    import numpy as np

    low, high = result.disparity_range
    searched = f"{'given' if range_given else 'found'} range {low:.2f} to {high:.2f}"
    shown.heading(console, "Result")
    rows = [
        (
            "disparity",
            f"{np.nanmin(result.disparity):.3f} to {np.nanmax(result.disparity):.3f} px per view step, larger is "
            f"nearer ({searched})",
        ),
    ]
    if result.depth is not None:
        nearest, farthest = np.nanmin(result.depth), np.nanmax(result.depth)
        rows.append(("depth", f"{nearest:.3g} to {'infinity' if np.isinf(farthest) else f'{farthest:.3g} m'}"))
    unknown = 100 * float(np.isnan(result.disparity).mean())
    if unknown:
        rows.append(("unknown", f"{unknown:.2g} % of the pixels (NaN): masked in this view; --fill fills them"))
    rows += [
        ("time", _times(result)),
        ("converged", "yes" if result.converged else "no; more iterations may improve the map"),
        ("status", result.status),
    ]
    shown.lines(console, rows)


def show_scores(console: Console, lf: LightField, result: DepthResult) -> dict[str, Metrics]:
    """Print the metrics after each stage and what the confidence tells, or why there are none; returns the metrics."""
    if lf.truth is None:
        return {}
    shown.heading(console, "Against the ground truth (which the estimate does not use)")
    truth = lf.reference_truth()
    if truth is None:
        place = view_at(lf.truth.position)
        shown.remark(console, f"It belongs to the view at {place}, not to the reference view, so there is no score.")
        return {}
    from lfgpu.metrics import BORDER, evaluate, sparsification

    try:
        maps = result.disparity_stages
        rows = {name: evaluate(values, truth.disparity, mask=truth.mask) for name, values in maps.items()}
        curve = sparsification(result.disparity, result.confidence, truth.disparity, mask=truth.mask)
    except LightFieldError as error:
        shown.remark(console, f"The result cannot be scored: {error}")
        return {}
    shown.scores(console, rows)
    shown.remark(console, scored_where(next(iter(rows.values())).count, BORDER))
    shown.sparsification(console, curve)
    return rows


def scored_where(count: int, border: int) -> str:
    """Return the sentence below a table of scores."""
    return (
        f"Over {count} pixels, without a border of {border} px. BadPix counts undefined pixels as bad; the other "
        "metrics leave them out."
    )


def show_remarks(console: Console, sentences: tuple[str, ...]) -> None:
    """Print the findings about the cameras; nothing if there are none."""
    if sentences:
        shown.heading(console, "The cameras do not fit together (lfgpu check says more)")
        shown.lines(console, [("finding", sentence) for sentence in sentences])


def show_outputs(console: Console, folder: object, files: list[tuple[str, str]]) -> None:
    """Print the list of written files."""
    shown.heading(console, f"Written to {folder}")
    shown.lines(console, files)


def show_next(console: Console, *commands: Sequence[object]) -> None:
    """Print commands, as words, that show or use what was written; nothing if there are none."""
    if not commands:
        return
    shown.heading(console, "Try next")
    for _, *words in commands:
        console.print(f"  {program()} {' '.join(shlex.quote(str(word)) for word in words)}", soft_wrap=True)


def program() -> str:
    """Return the name by which a shell finds lfgpu from this folder, also in an environment that is not active."""
    beside = Path(sys.executable).with_name("lfgpu")
    if shutil.which("lfgpu") or not beside.exists():
        return "lfgpu"
    return shlex.quote(os.path.relpath(beside))


def _times(result: DepthResult) -> str:
    stages = ", ".join(f"{name} {s:.2f}" for name, s in result.timings.items() if name not in ("total", "compile"))
    compiling = result.timings.get("compile", 0.0)
    apart = f"; {compiling:.2f} s more to compile and load kernels, which are kept" if compiling else ""
    return f"{result.seconds:.2f} s ({stages}) with {result.backend} on {result.device}{apart}"
