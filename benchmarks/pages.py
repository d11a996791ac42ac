"""Tables of the pages, each made from committed result files."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks import (
    confidence,
    judge,
    like,
    live,
    misalignment,
    pairs,
    paper,
    pipelines,
    results,
    runs,
    tile_differences,
)
from benchmarks.cases import Case
from benchmarks.errors import BenchmarkError
from benchmarks.results import FOLDER, Record, Run
from benchmarks.tables import NONE, Table, duration

_ERRORS = {"mse_100": ".3g", "badpix_07": ".1f", "badpix_03": ".1f", "badpix_01": ".1f"}
_COMPARED = ("cotton", "kitchen", "vinyl")  # scenes of the HCI benchmark that other methods are published on
_NAMES = {name: name for name in ("fast", "accurate", "surest")} | {"paper": pipelines.RESIDENT}  # of pipelines


def content(path: Path) -> Any:
    """Read a result file; BenchmarkError if it cannot be read."""
    if not path.is_file():
        raise BenchmarkError(f"{path} is not there: a figure is to come from it.")
    return _read(path, path.stat().st_mtime_ns)


def newest(names: Iterable[str]) -> str:
    """Return the file of the newest version among `accuracy-VERSION.json`."""
    return max(names, key=lambda name: [int(number) for number in re.findall(r"\d+", name)])


@cache
def _read(path: Path, _: int) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BenchmarkError(f"{path} is not a JSON file.") from error


def _version(run: Run) -> str:
    major, minor, *_ = (run.versions["lfgpu"] or "").split(".")
    return f"{major}.{minor}"


def _rows(path: Path) -> Sequence[dict[str, Any]]:
    return content(path)["rows"]


# --- accuracy ---


def _errors_by_preset(found: Sequence[Record]) -> str:
    presets = list(dict.fromkeys(r.details["preset"] for r in found))
    rows = []
    for scene in dict.fromkeys(r.case for r in found):
        of = {r.details["preset"]: r.errors for r in found if r.case == scene}
        cells = {name: [f"{errors[m]:{how}}" for m, how in _ERRORS.items()] for name, errors in of.items()}
        best = [min(float(cell[place]) for cell in cells.values()) for place in range(len(_ERRORS))]
        rows.append((f"`{scene}`", *(_bold(cells[name], best) if name in cells else NONE for name in presets)))
    return Table("", ("scene", *(f"`{name}`" for name in presets)), len(presets) + 1, rows).markdown


def _bold(cells: Sequence[str], best: Sequence[float]) -> str:
    return " / ".join(f"**{c}**" if float(c) == b else c for c, b in zip(cells, best, strict=True))


def _compared(accuracy: Path, learned: Path, published: Path) -> str:
    """Write MSE x 100 and BadPix(0.07) of the presets and of published methods, and the time where it is known."""
    runs_of = {"no": results.load(accuracy), "on generated scenes": results.load(learned)}
    ours = [
        (f"**lfgpu {_version(run)}, `{preset}`**", trained, {r.case: r.errors for r in of}, _idle(run) and _seconds(of))
        for trained, run in runs_of.items()
        for preset in dict.fromkeys(r.details["preset"] for r in _range_found(run))
        for of in [[r for r in _range_found(run) if r.details["preset"] == preset]]
    ]
    others = [
        (method["name"], "yes" if method["trained"] else "no", method["errors"], method.get("seconds"))
        for method in content(published)["methods"]
    ]
    rows = [
        (name, trained, *(_scene(errors.get(scene)) for scene in _COMPARED), f"{time:.1f} s" if time else NONE)
        for name, trained, errors, time in sorted(ours + others, key=lambda row: row[1])
    ]
    columns = ("method", "trained", *(f"`{scene}`" for scene in _COMPARED), f"time, `{_COMPARED[0]}`")
    return f"{Table('', columns, 2, rows).markdown}\n\n{' '.join(dict.fromkeys(map(_where, runs_of.values())))}\n"


def _versions(*paths: Path) -> str:
    """Write MSE x 100 and BadPix(0.07) of `accurate`, a column for each version, and the time for one scene."""
    versions = [results.load(path) for path in paths]
    found = [{r.case: r for r in _range_found(run) if r.details["preset"] == "accurate"} for run in versions]
    rows = [(f"`{scene}`", *(_scene(of[scene].errors) for of in found)) for scene in found[-1]]
    times = (_seconds(list(of.values())) or 0.0 for of in found)
    rows.append((f"time, `{_COMPARED[0]}`, 2 cores of a CPU", *(f"{time:.1f} s" for time in times)))
    return Table("", ("scene", *map(_version, versions)), 1, rows).markdown


def _where(run: Run) -> str:
    used = "the GPU" if run.records[0].device.startswith("cuda") else "the CPU"
    return f"lfgpu {_version(run)}, measured on {run.date[:10]} with {used} of: {run.where}."


def _idle(run: Run) -> bool:
    return run.load is not None and run.load <= run.threads


def _range_found(run: Run) -> list[Record]:
    return [r for r in run.records if not r.failed and r.details["range"] == "found"]


def _seconds(found: Sequence[Record]) -> float | None:
    return next((r.seconds.median for r in found if r.case == _COMPARED[0] and r.seconds is not None), None)


def _scene(errors: Mapping[str, float] | None) -> str:
    return f"{errors['mse_100']:.2f} / {errors['badpix_07']:.1f}" if errors else NONE


# --- times ---


def _pipelines(path: Path) -> str:
    """Write the time of a light field in a pipeline that is there; in brackets upload, stages, download and memory."""
    found = _resident(path)
    columns = list(dict.fromkeys(r.case for r in found))
    rows = [(f"`{preset}`", *(_cell(found, preset, case, parts=True) for case in columns)) for preset in _NAMES]
    return Table("", ("preset", *columns), len(columns) + 1, rows).markdown


def _times(path: Path) -> str:
    """Write the same, a row for each size, without the stages."""
    found = _resident(path)
    sizes = list(dict.fromkeys(r.case for r in found))
    rows = [(case.replace("x", " × "), *(_cell(found, preset, case) for preset in _NAMES)) for case in sizes]
    return Table("", ("", *(f"`{name}`" for name in _NAMES)), len(_NAMES) + 1, rows).markdown


def _backends(path: Path) -> str:
    """Write the time of a light field with each backend and device, and its ratio to the first one's."""
    found = _resident(path)
    pairs = list(dict.fromkeys((r.backend, r.device) for r in found))
    rows = []
    for preset, name in _NAMES.items():
        of = {(r.backend, r.device): r.seconds.median for r in found if r.name == name and r.seconds is not None}
        if of:
            rows.append((f"`{preset}`", *(f"{duration(of[pair])} ({of[pair] / of[pairs[0]]:.1f})" for pair in pairs)))
    return Table("", ("preset", *(" ".join(pair) for pair in pairs)), len(pairs) + 1, rows).markdown


def _resident(path: Path) -> list[Record]:
    records = results.load(path).records
    return [r for r in records if r.kind == "pipeline" and r.name in _NAMES.values() and not r.failed]


def _growth(*paths: Path) -> str:
    """Write time, GB of the process and BadPix(0.07) in per cent of each preset, a row for each case."""
    found = [r for path in paths for r in results.load(path).records if r.kind == "pipeline"]
    cells = {
        (r.case, r.name): NONE
        if r.failed or r.seconds is None or r.host_bytes is None
        else f"{duration(r.seconds.median)} / {r.host_bytes / 1e9:.1f} / {r.errors['badpix_07']:.1f}"
        for r in found
    }
    names = list(dict.fromkeys(r.name for r in found))
    rows = [
        (sizes.replace("x", " × "), span or f"{Case.span:g}", *(cells.get((case, name), NONE) for name in names))
        for case in dict.fromkeys(r.case for r in found)
        for sizes, _, span in [case.partition("@")]
    ]
    return Table("", ("views × pixels", "span, px", *(f"`{name}`" for name in names)), 1, rows).markdown


def _cell(found: Sequence[Record], preset: str, case: str, *, parts: bool = False) -> str:
    for r in found:
        if (r.name, r.case) == (_NAMES[preset], case) and r.seconds is not None:
            first, *stages, last = (duration(seconds) for seconds in r.details["stages"].values())
            memory = f"; {r.gpu_bytes / 1e9:.1f} GB" if r.gpu_bytes else ""
            rest = f" ({first}, {' / '.join(stages)}, {last}{memory})" if parts else ""
            return duration(r.seconds.median) + rest
    return NONE


# --- others ---


def _reliability(path: Path) -> str:
    return confidence.by_confidence(_rows(path)).markdown


def _runs(*paths: Path) -> str:
    return "\n".join(runs.markdown(run) for run in results.merged(map(results.load, paths)))


def _new_views(path: Path) -> str:
    """Write the PSNR of whole views, rendered and as the mean of the neighbours."""
    names = ("rendered", "mean of neighbours")
    rows = [(f"`{row['scene']}`", *(f"{row['whole'][name]:.1f} dB" for name in names)) for row in _rows(path)]
    return Table("", ("scene", *names), 1, rows).markdown


ACCURACY = newest(path.name for path in FOLDER.glob("accuracy-*.json"))
"""The accuracy of the newest version that was measured."""
PUBLISHED = "published.json"
"""Figures that others publish about their methods, each with its source."""
TIMES = "h200-pipelines.json"
RUNS = (TIMES, "ablation.json")
TABLES: Mapping[str, tuple[tuple[str, ...], Callable[..., str]]] = {
    "ablation": (("ablation.json",), lambda path: runs.tables(results.load(path).records)[0].markdown),
    "backends": (("h100-vulkan.json",), _backends),
    "compared": ((ACCURACY, "learned.json", PUBLISHED), _compared),
    "confidence": (("confidence.json",), _reliability),
    "confidence-surest": (("confidence-surest.json",), _reliability),
    "experiments": (("paper.json",), lambda path: paper.experiments(results.load(path)).markdown),
    "forms": (("paper.json",), lambda path: paper.forms(results.load(path)).markdown),
    "growth": (("growth.json", "growth-4k.json"), _growth),
    "judge": (("judge.json",), lambda path: judge.table(content(path)["draws"]).markdown),
    "learned": (
        (ACCURACY, "learned.json"),
        lambda *paths: _errors_by_preset([record for path in paths for record in _range_found(results.load(path))]),
    ),
    "like": (("like.json",), lambda path: like.gain(results.load(path)).markdown),
    "like-scenes": (("like.json",), lambda path: _errors_by_preset(like.by_weights(results.load(path)))),
    "live": (("h200-live.json",), lambda path: live.table(_rows(path)).markdown),
    "misalignment": (("misalignment.json",), lambda path: misalignment.table(misalignment.load(path)).markdown),
    "new-views": (("rendering.json",), _new_views),
    "pairs": (("pairs.json",), lambda path: Table.of("", 3, _rows(path), pairs.COLUMNS).markdown),
    "paper": (
        ("paper-accuracy.json",),
        lambda path: _errors_by_preset([r for r in results.load(path).records if not r.failed]),
    ),
    "pipelines": ((TIMES,), _pipelines),
    "runs": (RUNS, _runs),
    "tiles": (("tiles.json",), lambda path: tile_differences.table(_rows(path)).markdown),
    "times": ((TIMES,), _times),
    "versions": (("accuracy-0.1.json", "accuracy-0.2.json"), _versions),
}
"""By name of the table: the result files that it needs, and how it is made of their paths."""
