"""Figures in the documents, written from committed result files.

A mark in Markdown says which file of `benchmarks/results` a figure comes from; the figure stands between its ends:

    MSE <!-- figure: ablation.json records/case=cotton*,name=fast/errors/mse_100 .2f -->0.50<!-- /figure -->

    <!-- table: ablation -->
    ...
    <!-- /table -->

A figure is a file, a path in it, and a format. The steps of a path are separated by `/`: a key of an object, or
`key=pattern,key=pattern` for the one entry of a list whose values match (`*` is any text, `?` any character, so that no
step holds a space). The format is Python's, with a factor before it where the unit differs: `1000*.1f`. A table is a
row of `benchmarks.pages.TABLES`.

A file is stale if the sources of its benchmark have changed since (`benchmarks.sources`). A page with a figure of such
a file gets a sentence below its heading that says so.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.errors import BenchmarkError
from benchmarks.pages import PUBLISHED, TABLES, content
from benchmarks.results import FOLDER
from benchmarks.sources import ROOT, is_stale
from lfgpu.io.atomic import atomic_write

PAGES = ("README.md", "CHANGELOG.md", "docs", "benchmarks")
"""Pages and folders of pages that may hold marks."""

_TABLE = re.compile(r"(?P<head><!-- table: (?P<name>\S+) -->\n)(?P<text>.*?)(?P<foot><!-- /table -->)", re.DOTALL)
_FIGURE = re.compile(
    r"(?P<head><!-- figure: (?P<file>\S+) (?P<path>\S+) (?P<format>\S+) -->)(?P<text>[^\n]*?)(?P<foot><!-- /figure -->)"
)
_ANY = re.compile(r"<!-- */?(?:figure|table)\b.*?-->")
NOTE = re.compile(r"<!-- stale -->\n.*?<!-- /stale -->\n\n", re.DOTALL)
"""The sentence of a page about its stale files."""
_HEADING = re.compile(r"^#{1,6} .*\n\n", re.MULTILINE)
_WIDTH = 120


@dataclass(frozen=True)
class Mark:
    """A figure or a table of a page."""

    page: Path
    line: int
    """From 1."""
    source: str
    """Files of `benchmarks/results`, and for a figure the path in it."""
    found: str
    """The text on the page."""
    wanted: str
    """The text by the files."""


def command(
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit with 1 if a page differs.")] = False,
    list_: Annotated[bool, typer.Option("--list", help="Write nothing; print what each figure comes from.")] = False,
    stale_: Annotated[
        bool,
        typer.Option("--stale", help="Write nothing; list the files whose sources have changed since; exit with 1."),
    ] = False,
) -> None:
    """Write the figures of README, docs and benchmarks anew from the files in benchmarks/results."""
    if stale_:
        names = stale(FOLDER)
        for name in names:
            typer.echo(name)
        if names:
            raise BenchmarkError(f"{len(names)} files are older than the code that they measure: measure them again.")
        return
    if not (check or list_):
        for page in write():
            typer.echo(f"written: {page.relative_to(ROOT)}")
        return
    found = [mark for page in pages() for mark in marks(page)]
    differing = [mark for mark in found if mark.found != mark.wanted]
    for line in listing(found if list_ else differing):
        typer.echo(line)
    if check and differing:
        raise BenchmarkError(f"{len(differing)} figures differ from their files: run python -m benchmarks figures.")


def pages(root: Path = ROOT) -> list[Path]:
    """List all Markdown pages that may hold marks."""
    places = [root / name for name in PAGES]
    found = [path for place in places for path in ([place] if place.is_file() else sorted(place.rglob("*.md")))]
    return [path for path in found if "made" not in path.parts]  # docs/made holds copies for the site


def stale(folder: Path) -> list[str]:
    """List the result files whose figures were measured with other sources than those that are here.

    Not among them are figures of released versions, whose files are named by the version, and those that others
    publish.
    """
    names = sorted(path.name for path in folder.glob("*.json"))
    return [name for name in names if not _is_lasting(name) and is_stale(content(folder / name))]


def _is_lasting(name: str) -> bool:
    return name == PUBLISHED or name.startswith("accuracy-")


def marks(page: Path, folder: Path = FOLDER) -> list[Mark]:
    """Find the figures and tables of a page, in order; BenchmarkError for a mark that cannot be read or followed."""
    return [mark for mark, _ in _marks(page, page.read_text(encoding="utf-8"), folder)]


def written(page: Path, folder: Path = FOLDER) -> str:
    """Return the text of a page with all its figures and tables as the files have them."""
    text = page.read_text(encoding="utf-8")
    parts, at = [], 0
    for mark, (first, last) in _marks(page, text, folder):
        parts += [text[at:first], mark.wanted]
        at = last
    return "".join([*parts, text[at:]])


def write(root: Path = ROOT, folder: Path = FOLDER) -> list[Path]:
    """Write all pages anew, and return those that changed. Nothing is written if a mark of any page is wrong."""
    texts = {page: written(page, folder) for page in pages(root)}
    changed = [page for page, text in texts.items() if text != page.read_text(encoding="utf-8")]
    for page in changed:
        with atomic_write(page) as temporary:
            temporary.write_text(texts[page], encoding="utf-8")
    return changed


def value(folder: Path, file: str, path: str) -> Any:
    """Look up a path in a result file; BenchmarkError if there is nothing, or more than one thing."""
    found = content(folder / file)
    for step in path.split("/"):
        found = _step(found, step, f"{file}, {path}")
    return found


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


def _formatted(number: Any, how: str, where: str) -> str:
    factor, times, spec = how.rpartition("*")
    try:
        return format(float(factor) * number if times else number, spec)
    except (TypeError, ValueError) as error:
        raise BenchmarkError(f"{where}: {number!r} cannot be written as {how!r}.") from error


def _marks(page: Path, text: str, folder: Path) -> Iterator[tuple[Mark, tuple[int, int]]]:
    """Find every mark, the sentence about stale files included, and the place of its text."""
    found = list(_figures(page, text, folder))
    old = sorted({name for mark, _ in found for name in re.findall(r"\S+\.json", mark.source)} & set(stale(folder)))
    note = NOTE.search(text)
    if note or old:
        of_old = next((at for mark, (at, _) in found if set(re.findall(r"\S+\.json", mark.source)) & set(old)), 0)
        place = max((heading.end() for heading in _HEADING.finditer(text, 0, of_old)), default=0)
        first, last = note.span() if note else (place, place)
        found.append((Mark(page, _line(text, first), ", ".join(old), text[first:last], _note(old)), (first, last)))
    yield from sorted(found, key=lambda mark: mark[1])


def _note(names: Sequence[str]) -> str:
    """Write the sentence of a page about its stale files, "" if there are none."""
    if not names:
        return ""
    listed = ", ".join(f"`{name}`" for name in names)
    sentence = (
        f"*Older than the code: the figures from {listed} were measured before the last change of the code that they "
        "are about. The page says so until they are measured again.*"
    )
    return f"<!-- stale -->\n{textwrap.fill(sentence, _WIDTH, break_on_hyphens=False)}\n<!-- /stale -->\n\n"


def _figures(page: Path, text: str, folder: Path) -> Iterator[tuple[Mark, tuple[int, int]]]:
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
            if match["name"] not in TABLES:
                raise BenchmarkError(
                    f"{page.name}, line {line}: unknown table {match['name']!r}; there are {', '.join(sorted(TABLES))}."
                )
            files, make = TABLES[match["name"]]
            wanted = make(*(folder / name for name in files)).strip() + "\n"
            source = ", ".join(files)
        yield Mark(page, line, source, match["text"], wanted), match.span("text")


def _in_code(text: str, place: int) -> bool:
    """Return whether a mark is an example: in a block of code that is indented, or within backticks."""
    before = text[text.rfind("\n", 0, place) + 1 : place]
    return before.startswith("    ") or before.count("`") % 2 == 1


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1


def listing(found: Sequence[Mark]) -> list[str]:
    """Say where each figure stands and where it comes from, a line each."""
    return [f"{mark.page.relative_to(ROOT)}:{mark.line}: {_short(mark.found)} < {mark.source}" for mark in found]


def _short(text: str) -> str:
    rows = text.count("\n")
    return f"table of {rows} lines" if rows else text
