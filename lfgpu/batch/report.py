"""The report of a batch: one page with a row for each item, failed ones first."""

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from statistics import fmean, median
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from lfgpu.batch.items import ERROR_FILE, PREVIEW_FILE, VIEW_FILE
from lfgpu.batch.manifest import DONE
from lfgpu.batch.run import Summary
from lfgpu.comparison import COLUMNS
from lfgpu.io.map_formats import REPORT_FILE
from lfgpu.reports.facts import date, preset
from lfgpu.viz.cards import Scale, Tile, scale
from lfgpu.viz.colours import LOOKS
from lfgpu.viz.pages import rendered, write_page
from lfgpu.viz.scales import ERRORS

_UNITS = {name: "%" for name in COLUMNS if name.startswith("BadPix")}
_FIRST = ("BadPix 0.07", "MSE x100")  # scores that are read first


def write_report(summary: Summary, out: Path, title: str) -> Path:
    """Write the page atomically into the folder of the batch, because it refers to pictures there."""
    entries = [summary.entries[item.name] for item in summary.items if item.name in summary.entries]
    page = rendered(
        "batch.html",
        title=f"{title}: depth by lfgpu",
        name=title,
        lead=_lead(summary),
        tiles=_tiles(summary),
        facts=[(label, _typeset(text)) for label, text in facts(summary)],
        keys=[
            "item",
            "seconds",
            "searched range",
            *(map(_typeset, COLUMNS) if any(e.get("metrics") for e in entries) else ()),
        ],
        gradients={kind: scale(kind, (0.0, 1.0)).stops for kind in ("disparity", "error")},
        errors=scale("error", ERRORS, below=True, above=True),
        unit=LOOKS["disparity"].title,
        rows=[_row(entry) for entry in sorted(entries, key=lambda entry: entry.get("status") == DONE)],
    )
    path = out / REPORT_FILE
    write_page(path, page)
    return path


def _lead(summary: Summary) -> str:
    """Say when the items were computed, and by which preset."""
    ends = [entry["began"] + entry.get("seconds", 0.0) for entry in summary.entries.values() if "began" in entry]
    when = [f"finished {date(datetime.fromtimestamp(max(ends)).astimezone())}"] if ends else []
    by = [] if summary.settings is None else [f"preset {preset(summary.settings.config)}"]
    return ", ".join(["Disparity by lfgpu", *by, *when])


def _tiles(summary: Summary) -> list[Tile]:
    done = [entry for entry in summary.entries.values() if entry.get("status") == DONE]
    share = 100 * len(done) / len(summary.items) if summary.items else 100.0
    tiles = [Tile("Done", f"{share:.4g}", "%", f"{len(done)} of {len(summary.items)} items")]
    if summary.failed:
        tiles.append(Tile("Failed", str(len(summary.failed)), "", "items; they come first below"))
    tiles += [
        Tile(_typeset(name), _score(name, value), unit, f"mean of {sum(1 for e in done if e.get('metrics'))} items")
        for name, value, unit in _means(done)
        if name in _FIRST
    ]
    if done:
        tiles.append(Tile("Time per item", f"{median(e.get('seconds', 0.0) for e in done):.3g}", "s", "median"))
    return tiles


def facts(summary: Summary) -> list[tuple[str, str]]:
    """List counts, times and mean scores, as pairs of label and text."""
    done = [entry for entry in summary.entries.values() if entry.get("status") == DONE]
    share = 100 * len(done) / len(summary.items) if summary.items else 100.0
    lines = [
        (
            "items",
            f"{len(summary.items)}: {len(done)} done, {len(summary.failed)} failed, {summary.left} not reached; "
            f"{share:.4g} % done",
        ),
        ("this run", f"{summary.computed} computed, {summary.kept} kept from before, in {summary.seconds:.1f} s"),
    ]
    if summary.settings is not None:
        lines.insert(1, ("preset", preset(summary.settings.config)))
    times = [entry["times"] for entry in done if "times" in entry]
    if summary.damaged:
        lines.append(("manifest", f"{summary.damaged} damaged lines were skipped; their items are done again"))
    if times:
        parts = ", ".join(f"{name} {median(t.get(name, 0.0) for t in times):.3g}" for name in times[0])
        each = median(entry.get("seconds", 0.0) for entry in done)
        lines.append(("time per item", f"{each:.3g} s, median ({parts})"))
    if means := _means(done):
        scored = sum(1 for entry in done if entry.get("metrics"))
        text = ", ".join(f"{name} {_score(name, value)} {unit}".rstrip() for name, value, unit in means)
        lines.append(("mean scores", f"{text}, of {scored} with ground truth"))
    return lines


def _means(entries: Sequence[Mapping[str, Any]]) -> list[tuple[str, float, str]]:
    """Average each metric over the items with ground truth; returns names, means and units."""
    scored = [entry["metrics"] for entry in entries if entry.get("metrics")]
    values = {name: [m[key] for m in scored if m.get(key) is not None] for name, key in COLUMNS.items()}
    return [(name, fmean(of), _UNITS.get(name, "")) for name, of in values.items() if of]


def _score(name: str, value: float) -> str:
    """Format a score: two digits after the point for shares in per cent, else three."""
    return f"{value:.2f}" if name in _UNITS else f"{value:.3f}"


def _typeset(name: str) -> str:
    return name.replace("x100", "\u00d7100")


def _link(name: str) -> str:
    """Quote a name for an address, also one that is not UTF-8, or comes from a damaged manifest."""
    try:
        return quote(name.encode(errors="surrogateescape"))
    except UnicodeEncodeError:
        return quote(name.encode(errors="surrogatepass"))


def _row(entry: Mapping[str, Any]) -> dict[str, Any]:
    done, metrics, sizes = entry.get("status") == DONE, entry.get("metrics") or {}, entry.get("sizes", ())
    folder, seconds = _link(entry["item"]), entry.get("seconds", 0.0)
    scores = {name: metrics.get(key) for name, key in COLUMNS.items()}
    numbers, span = [("seconds", f"{seconds:.2f}")], None
    if done and "disparity_range" in entry:
        low, high = entry["disparity_range"]
        span = high - low
        numbers.append(("searched range, px", f"{low:.2f} to {high:.2f}".replace("-", "\u2212")))
    numbers += [
        (_typeset(name), f"{_score(name, score)} {_UNITS.get(name, '')}".rstrip())
        for name, score in scores.items()
        if score is not None
    ]
    height, width = entry.get("size") or (0, 0)
    return {
        "name": entry["item"],
        "error": "" if done else entry.get("error", ""),
        "notes": [*entry.get("notes", []), *entry.get("remarks", [])],
        "link": f"{folder}/{REPORT_FILE if REPORT_FILE in sizes else ''}" if done else "",
        "view": f"{folder}/{VIEW_FILE}" if VIEW_FILE in sizes else "",
        "picture": f"{folder}/{PREVIEW_FILE}" if PREVIEW_FILE in sizes else "",
        "errors": f"{folder}/{ERROR_FILE}" if ERROR_FILE in sizes else "",
        "shape": Markup(' width="{}" height="{}"').format(width, height) if height else "",
        "scale": _scale(entry.get("scale") or {}),
        "numbers": numbers,
        "key_values": json.dumps([entry["item"], seconds, span, *scores.values()]),
    }


def _scale(found: Mapping[str, float]) -> Scale | None:
    """Make the scale of an item's map; None if its entry has none."""
    if not {"low", "high"} <= found.keys():
        return None
    beyond = {name: bool(found.get(name)) for name in ("below", "above", "undefined")}
    return scale("disparity", (found["low"], found["high"]), **beyond)
