"""Figures in the documents, written from committed result files.

A mark in Markdown says which file of `benchmarks/results` a figure comes from; the figure stands between its ends:

    MSE <!-- figure: ablation.json records/case=cotton*,name=fast/errors/mse_100 .2f -->0.50<!-- /figure -->

    <!-- table: ablation -->
    ...
    <!-- /table -->

A figure is a file, a path in it, and a format. The steps of a path are separated by `/`: a key of an object, or
`key=pattern,key=pattern` for the one entry of a list whose values match (`*` is any text, `?` any character, so that no
step holds a space). The format is Python's, with a factor before it where the unit differs: `1000*.1f`. A table is a
row of `TABLES`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks import confidence, merge, operations, paper, pipelines, rendering, results, show, tables
from benchmarks.errors import BenchmarkError
from lfgpu.io.atomic import atomic_write

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).with_name("results")
PAGES = ("README.md", "docs", "benchmarks")
"""Pages and folders of pages that may hold marks."""

_TABLE = re.compile(r"(?P<head><!-- table: (?P<name>\S+) -->\n)(?P<text>.*?)(?P<foot><!-- /table -->)", re.DOTALL)
_FIGURE = re.compile(
    r"(?P<head><!-- figure: (?P<file>\S+) (?P<path>\S+) (?P<format>\S+) -->)(?P<text>[^\n]*?)(?P<foot><!-- /figure -->)"
)
_ANY = re.compile(r"<!-- */?(?:figure|table)\b.*?-->")


@dataclass(frozen=True)
class Mark:
    """A figure or a table of a page."""

    page: Path
    line: int
    """From 1."""
    source: str
    """Files of `benchmarks/results`, and for a figure the path in it."""
    found: str
    """What stands there."""
    wanted: str
    """What the files say."""


def pages(root: Path = ROOT) -> list[Path]:
    """All Markdown pages that may hold marks."""
    places = [root / name for name in PAGES]
    found = [path for place in places for path in ([place] if place.is_file() else sorted(place.rglob("*.md")))]
    return [path for path in found if "made" not in path.parts]  # docs/made holds copies for the site


def marks(page: Path, folder: Path = RESULTS) -> list[Mark]:
    """The figures and tables of a page in their order; BenchmarkError for a mark that cannot be read or followed."""
    return [mark for mark, _ in _marks(page, page.read_text(encoding="utf-8"), folder)]


def written(page: Path, folder: Path = RESULTS) -> str:
    """The text of a page with all its figures and tables as the files have them."""
    text = page.read_text(encoding="utf-8")
    parts, at = [], 0
    for mark, (first, last) in _marks(page, text, folder):
        parts += [text[at:first], mark.wanted]
        at = last
    return "".join([*parts, text[at:]])


def write(root: Path = ROOT, folder: Path = RESULTS) -> list[Path]:
    """Write all pages anew; the ones that changed. Nothing is written if a mark of any page is wrong."""
    texts = {page: written(page, folder) for page in pages(root)}
    changed = [page for page, text in texts.items() if text != page.read_text(encoding="utf-8")]
    for page in changed:
        with atomic_write(page) as temporary:
            temporary.write_text(texts[page], encoding="utf-8")
    return changed


def value(folder: Path, file: str, path: str) -> Any:
    """What stands in a result file at a path; BenchmarkError if there is nothing, or more than one thing."""
    content = _content(folder / file)
    for step in path.split("/"):
        content = _step(content, step, f"{file}, {path}")
    return content


def _step(content: Any, step: str, where: str) -> Any:
    if isinstance(content, list):
        wanted = [part.partition("=") for part in step.split(",")]
        if not all(equals for _, equals, _ in wanted):
            raise BenchmarkError(f"{where}: {step!r} names no entry of a list; write key=pattern.")
        found = [
            entry
            for entry in content
            if all(isinstance(entry, dict) and fnmatchcase(str(entry.get(k)), pattern) for k, _, pattern in wanted)
        ]
        if len(found) != 1:
            raise BenchmarkError(f"{where}: {len(found)} entries match {step!r}, and it has to be one.")
        return found[0]
    if not isinstance(content, dict) or step not in content:
        raise BenchmarkError(f"{where}: there is no {step!r}.")
    return content[step]


@cache
def _read(path: Path, _: int) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BenchmarkError(f"{path} is not a JSON file.") from error


def _content(path: Path) -> Any:
    if not path.is_file():
        raise BenchmarkError(f"{path} is not there: a figure is to come from it.")
    return _read(path, path.stat().st_mtime_ns)


def _formatted(number: Any, how: str, where: str) -> str:
    factor, times, spec = how.rpartition("*")
    try:
        return format(float(factor) * number if times else number, spec)
    except (TypeError, ValueError) as error:
        raise BenchmarkError(f"{where}: {number!r} cannot be written as {how!r}.") from error


def _marks(page: Path, text: str, folder: Path) -> Iterator[tuple[Mark, tuple[int, int]]]:
    """Every mark, and where its text stands."""
    whole = sorted([*_TABLE.finditer(text), *_FIGURE.finditer(text)], key=lambda match: match.start())
    ends = {place for match in whole for place in (match.start("head"), match.start("foot"))}
    for loose in _ANY.finditer(text):
        if loose.start() not in ends and not _in_code(text, loose.start()):
            raise BenchmarkError(f"{page.name}, line {_line(text, loose.start())}: {loose[0]} is no whole mark.")
    for match in whole:
        if _in_code(text, match.start()):
            continue
        line = _line(text, match.start())
        if match.re is _FIGURE:
            if text[: match.start()].endswith("\n"):
                raise BenchmarkError(
                    f"{page.name}, line {line}: a figure begins the line, which makes it all raw HTML; move a word."
                )
            file, path = match["file"], match["path"]
            wanted = _formatted(value(folder, file, path), match["format"], f"{page.name}, line {line}")
            source = f"{file} {path}"
        else:
            table = _table(match["name"], f"{page.name}, line {line}")
            wanted = table.make(folder).strip() + "\n"
            source = ", ".join(table.files) or "the code"
        yield Mark(page, line, source, match["text"], wanted), match.span("text")


def _in_code(text: str, place: int) -> bool:
    """Whether a mark is an example: in a block of code that is indented, or within backticks."""
    before = text[text.rfind("\n", 0, place) + 1 : place]
    return before.startswith("    ") or before.count("`") % 2 == 1


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1


# --- whole tables ---


@dataclass(frozen=True)
class Table:
    """A table that a page may hold: the result files that it needs, and how it is made of a folder of them."""

    files: tuple[str, ...]
    make: Callable[[Path], str]


def _ablation(folder: Path) -> str:
    return show.markdown_table(tables.tables(results.load(folder / "ablation.json").records)[0])


def _accuracy(folder: Path) -> str:
    """MSE x 100 and the three BadPix of each scene and preset; the best of a row is bold."""
    return f"{_errors_by_preset(_range_found(folder))}\n\n{_where(folder)}\n"


def _paper(folder: Path) -> str:
    """The same of the preset `paper` beside the others."""
    records = results.load(folder / "paper-accuracy.json").records
    return _errors_by_preset([r for r in records if not r.failed])


def _errors_by_preset(found: Sequence[results.Record]) -> str:
    presets = list(dict.fromkeys(r.details["preset"] for r in found))
    rows = []
    for scene in dict.fromkeys(r.case for r in found):
        of = {r.details["preset"]: r.errors for r in found if r.case == scene}
        cells = {name: [f"{errors[m]:{how}}" for m, how in _ERRORS.items()] for name, errors in of.items()}
        best = [min(float(cell[place]) for cell in cells.values()) for place in range(len(_ERRORS))]
        rows.append((f"`{scene}`", *(_bold(cells[name], best) if name in cells else tables.NONE for name in presets)))
    columns = ("scene", *(f"`{name}`" for name in presets))
    return show.markdown_table(tables.Table("", columns, len(presets) + 1, rows))


def _compared(folder: Path) -> str:
    """MSE x 100 and BadPix(0.07) of the presets and of published methods; time where it is known."""
    ours = [
        (f"**lfgpu {_version(ACCURACY)}, `{preset}`**", "no", {r.case: r.errors for r in of}, _seconds(of))
        for preset in dict.fromkeys(r.details["preset"] for r in _range_found(folder))
        for of in [[r for r in _range_found(folder) if r.details["preset"] == preset]]
    ]
    others = [
        (method["name"], "yes" if method["trained"] else "no", method["errors"], method.get("seconds"))
        for method in json.loads((folder / PUBLISHED).read_text(encoding="utf-8"))["methods"]
    ]
    rows = [
        (name, trained, *(_scene(errors.get(scene)) for scene in _COMPARED), f"{time:.1f} s" if time else tables.NONE)
        for name, trained, errors, time in sorted(ours + others, key=lambda row: row[1])
    ]
    columns = ("method", "trained", *(f"`{scene}`" for scene in _COMPARED), f"time, `{_COMPARED[0]}`")
    return f"{show.markdown_table(tables.Table('', columns, 2, rows))}\n\n{_where(folder)}\n"


def _where(folder: Path) -> str:
    """What the accuracy was measured with, and on what."""
    run = results.load(folder / ACCURACY)
    used = "the GPU" if run.records[0].device.startswith("cuda") else "the CPU"
    return f"lfgpu {_version(ACCURACY)}, measured on {run.date[:10]} with {used} of: {run.where}."


def _version(name: str) -> str:
    return name.removeprefix("accuracy-").removesuffix(".json")


def newest(names: Iterable[str]) -> str:
    """The file of the newest version among `accuracy-VERSION.json`."""
    return max(names, key=lambda name: [int(number) for number in _version(name).split(".")])


def _range_found(folder: Path) -> list[results.Record]:
    records = results.load(folder / ACCURACY).records
    return [r for r in records if not r.failed and r.details["range"] == "found"]


def _seconds(found: Sequence[results.Record]) -> float | None:
    return next((r.seconds.median for r in found if r.case == _COMPARED[0] and r.seconds is not None), None)


def _scene(errors: Mapping[str, float] | None) -> str:
    return f"{errors['mse_100']:.2f} / {errors['badpix_07']:.1f} %" if errors else tables.NONE


def _bold(cells: Sequence[str], best: Sequence[float]) -> str:
    return " / ".join(f"**{c}**" if float(c) == b else c for c, b in zip(cells, best, strict=True))


def _runs(folder: Path) -> str:
    runs = merge.merged(results.load(folder / name) for name in RUNS)
    return "\n".join(show.markdown(run) for run in runs)


def _formulas(_: Path) -> str:
    rows = [(f"`{operation.name}`", operation.formula) for operation in operations.OPERATIONS]
    return show.markdown_table(tables.Table("", ("operation", "reads → writes"), 2, rows))


def _pipelines(folder: Path) -> str:
    """A light field in a pipeline that is there: whole time, and in brackets upload, stages, download."""
    found = _resident(folder)
    columns = list(dict.fromkeys(r.case for r in found))
    rows = [(f"`{preset}`", *(_cell(found, preset, case, parts=True) for case in columns)) for preset in _PRESETS]
    return show.markdown_table(tables.Table("", ("preset", *columns), len(columns) + 1, rows))


def _times(folder: Path) -> str:
    """The same, a row for each size, without the stages."""
    found = _resident(folder)
    sizes = [case for case in dict.fromkeys(r.case for r in found) if _cell(found, "fast", case) != tables.NONE]
    rows = [(case.replace("x", " × "), *(_cell(found, preset, case) for preset in _PRESETS)) for case in sizes]
    return show.markdown_table(tables.Table("", ("", *(f"`{name}`" for name in _PRESETS)), len(_PRESETS) + 1, rows))


def _forms(folder: Path) -> str:
    return _as_table(paper.forms(results.load(folder / "paper.json")), 1)


def _experiments(folder: Path) -> str:
    return _as_table(paper.experiments(results.load(folder / "paper.json")), 2)


def _tiles(folder: Path) -> str:
    rows = [("scene", "size", "preset", "stage", "largest, px", "share above 0.001 px", "share above 0.01 px")]
    for r in value(folder, "tiles.json", "rows"):
        shares = (f"{r[name]:.2f} %" for name in ("above 0.001", "above 0.01"))
        height, width = r["size"]
        what = f"`{r['scene']}`", f"{height} × {width}", f"`{r['preset']}`", r["stage"]
        rows.append((*what, f"{r['largest']:.2g}", *shares))
    return _as_table(rows, 4)


def _live(folder: Path) -> str:
    """Rate, latency and errors of streams, warm and cold."""
    rows = [("preset", "size", "maps / s", "latency, ms: median, 95 %, 99 %", "MSE, BadPix(0.07) to a cold `accurate`")]
    for r in value(folder, "h200-live.json", "rows"):
        latency = ", ".join(f"{r[f'latency_p{quantile}']:.1f}" for quantile in (50, 95, 99))
        what = f"`{r['preset']}`, {'warm' if r['warm'] else 'cold'}", r["case"].replace("x", " × ")
        rows.append((*what, f"{r['rate']:.0f}", latency, f"{r['mse_ratio']:.2f}, {r['bad_ratio']:.2f}"))
    return _as_table(rows, 2)


def _rendering(folder: Path) -> str:
    """PSNR of rendered views, and of two simple ways."""
    return rendering.markdown(_rendered(folder))


def _new_views(folder: Path) -> str:
    """The same in short: whole views, rendered and as the mean of the neighbours."""
    names = ("rendered", "mean of neighbours")
    rows = [(f"`{row.scene}`", *(f"{row.whole[name]:.1f} dB" for name in names)) for row in _rendered(folder)]
    return _as_table([("scene", *names), *rows], 1)


def _rendered(folder: Path) -> list[rendering.Row]:
    return [rendering.Row(**row) for row in value(folder, "rendering.json", "rows")]


def _misalignment(folder: Path) -> str:
    """BadPix(0.03) less the median error with right, disturbed and lined up cameras, and the shifts of the views."""
    columns = ("scene, views, px", "disturbance", "undisturbed", "disturbed", "lined up", "shifts before", "after")
    rows = []
    for r in value(folder, "misalignment.json", "rows"):
        array = _ARRAYS.get(r["array"], r["array"].replace("x", " × ")).format(r["views"])
        levels = (f"{r[name]['level_03']:.1f}" for name in ("right", "wrong", "refined"))
        shifts = (tables.NONE if r[name] is None else f"{r[name]:.3f}" for name in ("off_px", "left_px"))
        how = "all five" if r["disturbance"].count(",") == 4 else r["disturbance"].replace("=", " ")
        rows.append((f"`{r['scene']}`, {array}, {r['crop']}", how, *levels, *shifts))
    return _as_table([columns, *sorted(rows)], 2)


def _judge(folder: Path) -> str:
    """How often a moved view was found, by scene."""
    draws = value(folder, "judge.json", "draws")
    scenes = {**{d["scene"]: [e for e in draws if e["scene"] == d["scene"]] for d in draws}, "all": draws}
    columns = ("scene", "draws", "found by `check`", "by the quick look", "false alarms", "shift off by at most, px")
    rows: list[tuple[str, ...]] = [columns]
    for name, some in scenes.items():
        counts = (str(sum(bool(d[key]) for d in some)) for key in ("is_found", "is_found_quickly", "false_alarms"))
        off = max(math.dist(d["found"], d["moved"]) for d in some)
        rows.append((f"`{name}`" if name != "all" else name, str(len(some)), *counts, f"{off:.3f}"))
    return _as_table(rows, 1)


def _confidence(folder: Path) -> str:
    """How often pixels of each confidence are right: on all maps, and on the map on which they are seldomest."""
    columns = ("confidence", "share of pixels", "stated", "right", "right on the worst map")
    whole, *maps = value(folder, "confidence.json", "rows")
    rows = []
    for low, high in pairwise(confidence.EDGES):
        together, *each = (_bin(row, low) for row in (whole, *maps))
        if together is not None:
            found = [(one["right"], row) for one, row in zip(each, maps, strict=True) if one is not None]
            right, worst = min(found, key=lambda one: one[0])
            shares = (f"{100 * together[name]:.0f} %" for name in ("share", "said", "right"))
            on_worst = f"{100 * right:.0f} % (`{worst['scene']}`, `{worst['preset']}`)"
            rows.append((f"{low:g} to {high:g}", *shares, on_worst))
    return _as_table([columns, *reversed(rows)], 1)


def _bin(row: Mapping[str, Any], low: float) -> Mapping[str, float] | None:
    """The bin of a row that begins there, if it holds enough pixels to be shown."""
    return next((b for b in row["bins"] if b["low"] == low and b["share"] >= confidence.LEAST_SHARE), None)


_ARRAYS = {"star": "star of {}", "row": "row of {}", "irregular": "{} in no grid"}


def _as_table(rows: Sequence[tuple[str, ...]], labels: int) -> str:
    return show.markdown_table(tables.Table("", rows[0], labels, rows[1:]))


def _resident(folder: Path) -> list[results.Record]:
    names = {_NAMES[preset] for preset in _PRESETS}
    runs = [results.load(folder / name) for name in H200]
    return [r for run in runs for r in run.records if r.kind == "pipeline" and r.name in names and not r.failed]


def _cell(found: Sequence[results.Record], preset: str, case: str, *, parts: bool = False) -> str:
    for r in found:
        if (r.name, r.case) == (_NAMES[preset], case) and r.seconds is not None:
            first, *stages, last = (tables.duration(seconds) for seconds in r.details["stages"].values())
            memory = f"; {r.gpu_bytes / 1e9:.1f} GB" if r.gpu_bytes else ""
            rest = f" ({first}, {' / '.join(stages)}, {last}{memory})" if parts else ""
            return tables.duration(r.seconds.median) + rest
    return tables.NONE


_ERRORS = {"mse_100": ".3g", "badpix_07": ".1f", "badpix_03": ".1f", "badpix_01": ".1f"}
_COMPARED = ("cotton", "kitchen", "vinyl")  # scenes of the HCI benchmark that other methods are published on
_PRESETS = ("fast", "accurate", "paper")
_NAMES = {"fast": "fast", "accurate": "accurate", "paper": pipelines.RESIDENT}
ACCURACY = newest(path.name for path in RESULTS.glob("accuracy-*.json"))
"""The accuracy of the newest version that was measured."""
PUBLISHED = "published.json"
"""What others publish about their methods, each with its source."""
H200 = ("h200-pipelines.json", "h200.json", "h200-17x17.json")  # what is newer comes first
RUNS = ("cpu-2-cores.json", "h200-machine-cpu.json", "h200-taichi.json", *H200, "ablation.json")
TABLES: Mapping[str, Table] = {
    "ablation": Table(("ablation.json",), _ablation),
    "accuracy": Table((ACCURACY,), _accuracy),
    "confidence": Table(("confidence.json",), _confidence),
    "compared": Table((ACCURACY, PUBLISHED), _compared),
    "experiments": Table(("paper.json",), _experiments),
    "paper": Table(("paper-accuracy.json",), _paper),
    "formulas": Table((), _formulas),
    "forms": Table(("paper.json",), _forms),
    "judge": Table(("judge.json",), _judge),
    "live": Table(("h200-live.json",), _live),
    "misalignment": Table(("misalignment.json",), _misalignment),
    "pipelines": Table(H200, _pipelines),
    "new-views": Table(("rendering.json",), _new_views),
    "rendering": Table(("rendering.json",), _rendering),
    "runs": Table(RUNS, _runs),
    "tiles": Table(("tiles.json",), _tiles),
    "times": Table(H200, _times),
}


def _table(name: str, where: str) -> Table:
    if name not in TABLES:
        raise BenchmarkError(f"{where}: unknown table {name!r}; there are {', '.join(sorted(TABLES))}.")
    return TABLES[name]


def listing(found: Sequence[Mark]) -> list[str]:
    """Where each figure stands and where it comes from, a line each."""
    return [f"{mark.page.relative_to(ROOT)}:{mark.line}: {_short(mark.found)} < {mark.source}" for mark in found]


def _short(text: str) -> str:
    rows = text.count("\n")
    return f"table of {rows} lines" if rows else text
