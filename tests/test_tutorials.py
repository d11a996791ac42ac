"""The code of *Start* and of the tutorials runs: all console and Python blocks of a page, in order, in an empty folder.

Blocks in the language `console` hold commands after `$`; the rest of their lines is output. Blocks in `python` share
their names within a page. A block with a caption is a file of that name. A console block of the class `fails` holds
commands that end with exit code 1. Blocks in `sh` and others are not run: they need what a test has not.
"""

import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu.cli import app, checkup
from tests.made import thorough

DOCS = Path(__file__).parents[1] / "docs"
PAGES = [DOCS / "start.md", *sorted((DOCS / "tutorials").glob("*.md"))]
_FENCE = re.compile(r"^(`{3,})([^`\n]*)\n(.*?)^\1`*$", re.MULTILINE | re.DOTALL)
_OPENED = re.compile(r"^`{3,}(?:\{code-block\} *)?(?:console|python)$", re.MULTILINE)
_OPTION = re.compile(r"^:(\w+): *(.*)\n", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code on a page."""

    language: str
    code: str
    options: dict[str, str]
    line: int


SMALLER = {
    **{"--grid 7x7 --size 96x128": "--grid 3x5 --size 80x96", "--grid 7x7 --size 128x160": "--grid 3x3 --size 96x112"},
    **{"--grid 5x5 --size 144x192": "--grid 3x3 --size 64x80", "--grid 5x5 --size 64x80": "--grid 3x3 --size 48x56"},
    "grid=(5, 5), size=(64, 80)": "grid=(3, 3), size=(48, 56)",
}
"""The light fields of pages, and those that `make test` has in their place; `make test-all` takes pages as they are."""


def blocks(page: Path, *, quick: bool = False) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for size, smaller in SMALLER.items() if quick else ():
        text = text.replace(size, smaller)
    for found in _FENCE.finditer(text):
        body, options = found[3], {}
        while option := _OPTION.match(body):
            options[option[1]] = option[2]
            body = body[option.end() :]
        yield Block(
            found[2].removeprefix("{code-block}").strip(), body, options, text.count("\n", 0, found.start()) + 2
        )


def run_commands(block: Block, page: Path) -> None:
    for line in block.code.splitlines():
        if not line.startswith("$ "):
            continue
        program, *arguments = shlex.split(line[2:])
        assert program == "lfgpu", f"{page.name}: {line}"
        outcome = CliRunner().invoke(app, arguments)
        wanted = 1 if "fails" in block.options.get("class", "") else 0
        assert outcome.exit_code == wanted, f"{page.name}: {line}\n{outcome.output}{outcome.exception!r}"


def follow(page: Path, *, quick: bool = False) -> int:
    """Do what a page says; the number of its blocks that were run."""
    names: dict[str, Any] = {"__name__": "__main__"}
    done = 0
    for block in blocks(page, quick=quick):
        if "caption" in block.options:
            Path(block.options["caption"]).write_text(block.code, encoding="utf-8")
        elif block.language == "console":
            run_commands(block, page)
        elif block.language == "python":
            exec(compile("\n" * (block.line - 1) + block.code, str(page), "exec"), names)
        else:
            continue
        done += 1
    return done


def cases() -> Iterator[Any]:
    for page in PAGES:
        text, name = page.read_text(encoding="utf-8"), page.stem
        if name != "index":
            yield pytest.param(page, True, id=name)
        if any(size in text for size in SMALLER):
            yield thorough(page, False, id=f"{name}, in full size")


@pytest.mark.parametrize(("page", "quick"), list(cases()))
def test_what_a_page_says_works(page: Path, quick: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])  # as where `lfgpu` is started
    there = tuple(info for info in checkup.describe_backends() if info.name != "taichi")  # its start takes seconds
    monkeypatch.setattr(checkup, "describe_backends", lambda: there)
    if quick:
        monkeypatch.setattr(lfgpu, "describe_backends", lambda: there, raising=False)
    assert follow(page, quick=quick) == len(_OPENED.findall(page.read_text(encoding="utf-8"))) >= 2


def test_a_page_that_does_not_work_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.md"
    page.write_text("```console\n$ lfgpu info nowhere\n```\n")
    with pytest.raises(AssertionError, match=r"page\.md: \$ lfgpu info nowhere"):
        follow(page)
    page.write_text("```{code-block} console\n:class: fails\n$ lfgpu info nowhere\n```\n\n```python\n1 / 0\n```\n")
    with pytest.raises(ZeroDivisionError):
        follow(page)
    page.write_text("```sh\nlfgpu info nowhere\n```\n")
    assert follow(page) == 0
    page.write_text("```{eval-rst}\n.. plot:: x.py\n```\n\n```python\n1 / 0\n```\n")
    with pytest.raises(ZeroDivisionError):
        follow(page)
