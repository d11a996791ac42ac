"""The README says what the code does: formats, commands, pictures, links, figures; and it stays short."""

import re
from pathlib import Path

import parameters_page

import lfgpu
from benchmarks import figures
from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.io import FORMATS

ROOT = Path(__file__).parents[1]
WHOLE = (ROOT / "README.md").read_text(encoding="utf-8")
README = figures.NOTE.sub("", WHOLE)
DOCS = ROOT / "docs"
MARKED = re.compile(r"<!-- (?:table|figure): .*?<!-- /(?:table|figure) -->", re.DOTALL)
NO_FIGURES = {
    "0.07": "the threshold of BadPix",
    "100": "of MSE×100",
    "5": "of a grid of 5 x 5, an example",
    "5x": "of a grid of 5 x 5, an example",
    "9": "9 x 9 views of the scene in the film",
    "3.11": "the version of Python",
    "4D": "light fields",
    "64": "float64",
    "2013": "a year",
    "2016": "a year",
    "0.2.0": "the version, compared below",
}
"""Numbers in the README that were not measured."""


def test_it_is_short_and_names_every_format_and_scene() -> None:
    found = parameters_page.PAGE.read_text(encoding="utf-8")
    assert found == parameters_page.page(), "run: python tests/parameters_page.py"
    note = re.compile(r"<!-- stale -->.*?<!-- /stale -->\n\n", re.DOTALL)  # until figures are measured again
    assert len(note.sub("", README).splitlines()) <= 120
    formats = (DOCS / "formats.md").read_text(encoding="utf-8")
    for entry in FORMATS:
        assert f"| `{entry.name}` |" in README
        assert f"| `{entry.name}` |" in formats
    page = (DOCS / "scenes.md").read_text(encoding="utf-8")
    for name in scenes.NAMES:
        assert f"| `{name}` |" in page


def test_links_commands_and_names_exist() -> None:
    names = re.findall(r"lfgpu\.(\w+)\(", README)
    assert names
    for name in names:
        assert hasattr(lfgpu, name), name
    targets = re.findall(r"\]\(([^)#:]+)[#)]", README)
    assert len(targets) > 20
    for target in targets:
        assert (ROOT / target).exists(), target
    rules = (ROOT / "Makefile").read_text()
    for rule in re.findall(r"(?:^    |`)make (\w+)", README, re.MULTILINE):
        assert f"\n{rule}:" in rules
    commands = {command.callback.__name__.rstrip("_") for command in app.registered_commands if command.callback}
    known = commands | {command.name for command in app.registered_commands}
    for command in re.findall(r"(?:^    |`)lfgpu (\w+)", README, re.MULTILINE):
        assert command in known, command
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.*)"', settings, re.MULTILINE)
    assert f"lfgpu-{version[1]}-py3-none-any.whl" in (DOCS / "start.md").read_text(encoding="utf-8")


def test_every_number_is_a_figure_with_a_source_or_none_that_was_measured() -> None:
    """What stands between marks is held by tests/test_packaging.py. Nothing else may look like a measurement."""
    prose = MARKED.sub("", README)
    prose = re.sub(r"\]\([^)]*\)|\w*64`?", "", prose)
    numbers = set(re.findall(r"(?<![\w-])\d[\d.]*\d\w?|(?<![\w-])\d\w?", prose))
    assert numbers <= NO_FIGURES.keys(), numbers - NO_FIGURES.keys()


def test_a_figure_that_differs_from_its_source_is_found(tmp_path: Path) -> None:
    """The test that holds the figures can fail: one digit of the README changed is one figure that differs."""
    page = tmp_path / "README.md"
    table = re.search(r"<!-- table: compared.*?<!-- /table -->", README, re.DOTALL)
    number = re.search(r"\d\.\d\d", table[0])

    def differ(text: str) -> list[str]:
        page.write_text(text, encoding="utf-8")
        return [mark.found for mark in figures.marks(page) if mark.found != mark.wanted]

    before = differ(table[0])  # a table by itself lacks the sentence that says that it is stale, if it is
    changed = differ(table[0].replace(number[0], "9.99", 1))
    assert len(changed) == len(before) + 1
    assert len(before) <= 1
