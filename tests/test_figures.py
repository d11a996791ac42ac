"""Figures in the pages are those of the committed result files; what a mark says, and which marks are errors."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks import figures, pages, sources
from benchmarks.cli import app
from benchmarks.errors import BenchmarkError
from benchmarks.results import FOLDER

CONTENT = {
    "date": "2026-01-02T03:04",
    "sources": sources.stamp("flicker"),
    "rows": [{"name": "a b", "n": 1, "ms": 0.1234}, {"name": "a c", "n": 2, "ms": 5.0}],
}
MARKED = (
    "MSE <!-- figure: run.json rows/name=a?b/ms 1000*.1f -->{}<!-- /figure --> of "
    "<!-- figure: run.json date .10 -->2026-01-02<!-- /figure -->\n"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of results with one file."""
    (tmp_path / "run.json").write_text(json.dumps(CONTENT), encoding="utf-8")
    return tmp_path


def page_of(folder: Path, text: str) -> Path:
    page = folder / "README.md"
    page.write_text(text, encoding="utf-8")
    return page


# --- the pages ---


def test_every_figure_of_the_pages_is_that_of_its_file() -> None:
    found = [mark for page in figures.pages() for mark in figures.marks(page)]
    differing = figures.listing([mark for mark in found if mark.found != mark.wanted])
    assert not differing, "run: python -m benchmarks figures"
    assert {"README.md", "batch.md"} <= {mark.page.name for mark in found}


def test_every_result_file_is_on_some_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in figures.pages())
    sources = " ".join(mark.source for page in figures.pages() for mark in figures.marks(page))
    assert [path.name for path in FOLDER.glob("*.json") if path.name not in text + sources] == []


def test_the_accuracy_is_that_of_the_newest_version() -> None:
    names = ["accuracy-0.2.json", "accuracy-0.10.json", "accuracy-0.1.json"]
    assert pages.newest(names) == "accuracy-0.10.json"
    assert pages.newest(path.name for path in FOLDER.glob("accuracy-*.json")) == pages.ACCURACY


def test_methods_stand_beside_each_other_and_the_machine_below() -> None:
    files, make = pages.TABLES["compared"]
    table = make(*(FOLDER / name for name in files))
    run = json.loads((FOLDER / pages.ACCURACY).read_text(encoding="utf-8"))
    ours = {r["details"]["preset"] for r in run["records"]}
    others = json.loads((FOLDER / pages.PUBLISHED).read_text(encoding="utf-8"))["methods"]
    assert len(re.findall(r"^\| ", table, re.MULTILINE)) == 2 + len(ours) + len(others)
    assert all(method["source"] and f"| {method['name']} |" in table for method in others)
    assert f"{run['machine']['cores']} cores" in table.splitlines()[-1]


# --- a mark ---


def test_a_figure_is_found_scaled_and_written(folder: Path) -> None:
    page = page_of(folder, MARKED.format("0.5"))
    first, second = figures.marks(page, folder)
    assert (first.found, first.wanted, first.source) == ("0.5", "123.4", "run.json rows/name=a?b/ms")
    assert second.found == second.wanted == "2026-01-02"
    assert figures.write(folder, folder) == [page]
    assert page.read_text(encoding="utf-8") == MARKED.format("123.4")
    assert figures.write(folder, folder) == []


def test_a_table_is_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = ("run.json",), lambda path: f"| {figures.value(path.parent, path.name, 'date')} |"
    monkeypatch.setattr(figures, "TABLES", {"dates": table})
    page = page_of(folder, "text\n\n<!-- table: dates -->\nold\n<!-- /table -->\n\nmore\n")
    figures.write(folder, folder)
    wanted = "text\n\n<!-- table: dates -->\n| 2026-01-02T03:04 |\n<!-- /table -->\n\nmore\n"
    assert page.read_text(encoding="utf-8") == wanted


@pytest.mark.parametrize(
    ("mark", "message"),
    [
        ("run.json rows/name=a*/ms .1f", "2 entries match"),
        ("run.json rows/name=z/ms .1f", "0 entries match"),
        ("run.json rows/0/ms .1f", "names no entry"),
        ("run.json rows/name=a?b/s .1f", "there is no 's'"),
        ("run.json rows/name=a?b/ms/x .1f", "there is no 'x'"),
        ("none.json date .10", "none.json is not there"),
        ("run.json date .1f", "cannot be written as"),
        ("run.json date x*.1f", "cannot be written as"),
    ],
)
def test_a_mark_that_leads_nowhere_is_an_error_and_nothing_is_written(folder: Path, mark: str, message: str) -> None:
    text = f"one <!-- figure: {mark} -->1<!-- /figure -->\n"
    page = page_of(folder, text)
    with pytest.raises(BenchmarkError, match=re.escape(message)):
        figures.write(folder, folder)
    assert page.read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a <!-- figure: run.json date .10 -->1\n", "line 1: .* is no whole mark"),
        ("a\nb <!-- figure: run.json date -->1<!-- /figure -->\n", "line 2: .* is no whole mark"),
        ("a <!-- /figure -->\n", "is no whole mark"),
        ("a\n<!-- figure: run.json date .10 -->1<!-- /figure --> b\n", "line 2: a figure begins the line"),
        ("<!-- table: nosuch -->\n<!-- /table -->\n", "unknown table 'nosuch'; there are ablation"),
        ("<!-- table: ablation -->\n", "is no whole mark"),
    ],
)
def test_a_mark_that_is_not_whole_is_an_error(folder: Path, text: str, message: str) -> None:
    with pytest.raises(BenchmarkError, match=message):
        figures.marks(page_of(folder, text), folder)


def test_examples_of_marks_are_none(folder: Path) -> None:
    page = page_of(folder, "    MSE <!-- figure: x y z -->1<!-- /figure -->\n\n`<!-- table: NAME -->` and so on\n")
    assert figures.marks(page, folder) == []


# --- stale files ---


def aged(folder: Path) -> None:
    old = {**CONTENT, "sources": {"benchmark": "flicker", "hash": "0"}}
    (folder / "run.json").write_text(json.dumps(old), encoding="utf-8")


def test_a_page_says_that_a_file_is_stale_until_it_is_measured_again(folder: Path) -> None:
    page = page_of(folder, "---\ntop: 1\n---\n\n# Title\n\n" + MARKED.format("123.4"))
    fresh = page.read_text(encoding="utf-8")
    assert figures.write(folder, folder) == []
    aged(folder)
    differing = [mark for mark in figures.marks(page, folder) if mark.found != mark.wanted]
    assert [(mark.line, mark.source) for mark in differing] == [(7, "run.json")]
    figures.write(folder, folder)
    top, note, rest = re.split(r"<!-- /?stale -->\n", page.read_text(encoding="utf-8"))
    assert "Older than the code: the figures from `run.json`" in note
    assert top + rest.removeprefix("\n") == fresh
    assert figures.write(folder, folder) == []
    (folder / "run.json").write_text(json.dumps(CONTENT), encoding="utf-8")
    figures.write(folder, folder)
    assert page.read_text(encoding="utf-8") == fresh


def test_files_without_a_hash_are_stale_and_those_of_released_versions_and_of_others_are_not(folder: Path) -> None:
    assert figures.stale(folder) == []
    aged(folder)
    for name in ("older.json", "accuracy-0.1.json", pages.PUBLISHED):
        (folder / name).write_text('{"rows": []}', encoding="utf-8")
    assert figures.stale(folder) == ["older.json", "run.json"]


def test_the_hash_follows_code_and_not_comments(tmp_path: Path) -> None:
    for place in (*sources.SOURCES["judge"], "benchmarks"):
        (tmp_path / place).mkdir(parents=True)
    code = tmp_path / "kernels" / "warp" / "some.py"
    native = tmp_path / "kernels" / "warp" / "some.cuh"

    def now() -> str:
        sources.hash_of.cache_clear()
        return sources.hash_of("judge", tmp_path)

    def after(text: str, file: Path = code) -> str:
        file.write_text(text, encoding="utf-8")
        return now()

    first = after("def f(x):\n    return 2 * x\n")
    assert after('"""Text."""\n\n\ndef f(x):  # what\n    """Double."""\n    return (\n        2 * x)\n') == first
    assert after("def f(x):\n    return 3 * x\n") != first
    assert after("def f(x):\n    return 2 * x\n") == first
    assert after("2", native) != first
    native.unlink()
    (tmp_path / "lfgpu" / "cameras" / "new.py").write_text("x = 1\n", encoding="utf-8")
    assert now() != first


def test_every_benchmark_names_sources_that_there_are() -> None:
    for benchmark, places in sources.SOURCES.items():
        missing = [place for place in (f"benchmarks/{benchmark}.py", *places) if not (sources.ROOT / place).exists()]
        assert missing == [], benchmark


# --- the command ---


def test_the_command_checks_and_lists(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    page = page_of(folder, MARKED.format("123.4"))
    monkeypatch.setattr(figures, "pages", lambda: [page])
    monkeypatch.setattr(figures, "FOLDER", folder)
    monkeypatch.setattr(figures, "listing", lambda found: [f"{mark.found} < {mark.source}" for mark in found])
    monkeypatch.setattr(figures, "marks", lambda page, marks=figures.marks: marks(page, folder))
    runner = CliRunner()
    assert runner.invoke(app, ["figures", "--check"]).exit_code == 0
    assert "123.4 < run.json rows/name=a?b/ms" in runner.invoke(app, ["figures", "--list"]).output
    assert runner.invoke(app, ["figures", "--stale"]).exit_code == 0
    aged(folder)
    done = runner.invoke(app, ["figures", "--stale"])
    assert (done.exit_code, done.output.splitlines()[0]) == (1, "run.json")
    (folder / "run.json").write_text(json.dumps(CONTENT), encoding="utf-8")
    page_of(folder, MARKED.format("99"))
    done = runner.invoke(app, ["figures", "--check"])
    assert done.exit_code == 1
    assert "99 < run.json" in done.output
    assert "2026-01-02 <" not in done.output
    assert "1 figures differ" in done.output
