"""The report of a batch: one page with a row for each item, failed ones first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from statistics import fmean, median
from typing import Any
from urllib.parse import quote

import jinja2

from lfgpu.batch.manifest import DONE
from lfgpu.batch.run import Summary
from lfgpu.batch.work import PREVIEW_FILE
from lfgpu.comparison import COLUMNS
from lfgpu.io.atomic import atomic_write

REPORT_FILE = "report.html"


def write_report(summary: Summary, out: Path, title: str) -> Path:
    """Write the page atomically into the folder of the batch, because it refers to pictures there."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined)
    text = resources.files("lfgpu").joinpath("templates/batch.html").read_text(encoding="utf-8")
    entries = [summary.entries[item.name] for item in summary.items if item.name in summary.entries]
    page = environment.from_string(text).render(
        title=title,
        facts=facts(summary),
        heads=list(COLUMNS),
        rows=[_row(entry) for entry in sorted(entries, key=lambda entry: entry.get("status") == DONE)],
    )
    path = out / REPORT_FILE
    with atomic_write(path) as temporary:
        # Names that are no text, which manifests may hold, are written out.
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")
    return path


def facts(summary: Summary) -> list[tuple[str, str]]:
    """Counts, times and mean scores, as pairs of label and text."""
    done = [entry for entry in summary.entries.values() if entry.get("status") == DONE]
    lines = [
        ("items", f"{len(summary.items)}: {len(done)} done, {len(summary.failed)} failed, {summary.left} not reached"),
        ("this run", f"{summary.computed} computed, {summary.kept} kept from before, in {summary.seconds:.1f} s"),
    ]
    times = [entry["times"] for entry in done if "times" in entry]
    if summary.damaged:
        lines.append(("manifest", f"{summary.damaged} damaged lines were skipped; their items are done again"))
    if times:
        parts = ", ".join(f"{name} {median(t.get(name, 0.0) for t in times):.3g}" for name in times[0])
        each = median(entry.get("seconds", 0.0) for entry in done)
        lines.append(("an item", f"{each:.3g} s, median ({parts})"))
    means = mean_scores(done)
    if means:
        scored = sum(1 for entry in done if entry.get("metrics"))
        text = ", ".join(f"{name} {value:.3f}" for name, value in means.items())
        lines.append(("mean scores", f"{text}, of {scored} with ground truth"))
    return lines


def mean_scores(entries: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The mean of each metric over the items with ground truth; empty if there is none."""
    scored = [entry["metrics"] for entry in entries if entry.get("metrics")]
    if not scored:
        return {}
    values = {name: [m[key] for m in scored if m.get(key) is not None] for name, key in COLUMNS.items()}
    return {name: fmean(of) for name, of in values.items() if of}


def _row(entry: Mapping[str, Any]) -> dict[str, Any]:
    done, metrics = entry.get("status") == DONE, entry.get("metrics")
    low, high = entry.get("disparity_range") or (math.nan, math.nan)
    picture = PREVIEW_FILE in entry.get("sizes", ())
    return {
        "name": entry["item"],
        "done": done,
        "error": entry.get("error", ""),
        "notes": entry.get("notes", []),
        "folder": quote(entry["item"]) + "/",
        "picture": f"{quote(entry['item'])}/{PREVIEW_FILE}" if picture else "",
        "seconds": f"{entry.get('seconds', 0.0):.2f}",
        "range": f"{low:.2f} to {high:.2f}" if done else "",
        "scores": ["–" if metrics.get(key) is None else f"{metrics[key]:.3f}" for key in COLUMNS.values()]
        if metrics
        else [],
    }
