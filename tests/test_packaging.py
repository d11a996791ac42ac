"""The package: its files, its requirements, the cost of importing it; figures in pages are those of result files."""

import importlib
import importlib.metadata
import json
import pkgutil
import re
import subprocess
import sys
import tomllib
from contextlib import suppress
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import lfgpu
from benchmarks import figures, pages, sources
from benchmarks.results import FOLDER
from lfgpu import _backends
from lfgpu.data import DepthResult
from lfgpu.methods import METHODS, PRESETS, method_of
from lfgpu.pipelines.pipeline import DepthPipeline

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
HEAVY = {"warp", "taichi", "matplotlib", "typer", "rich", "scipy", "imageio", "PIL"}


def run_python(code: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=600)


def required() -> set[str]:
    """Return the names that pip has for all requirements of lfgpu and its extras."""
    project = SETTINGS["project"]
    lines = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    return {re.match(r"[\w-]+", line)[0] for line in lines} - {"lfgpu"}  # type: ignore[index]


# --- what is installed ---


def test_packages_are_whole_and_every_extra_is_in_all() -> None:
    for backend, package in _backends._PACKAGES.items():
        assert (ROOT / "kernels" / backend / "__init__.py").is_file()
        assert package in required()
    extras = SETTINGS["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    large = {"train"}  # PyTorch: only who trains needs it
    assert set(everything.removeprefix("lfgpu[").removesuffix("]").split(",")) == extras.keys() - {"all"} - large
    there = installed_with_everything()
    assert {"numpy", "pydantic-core", "hatchling", "websockets"} <= there  # needed by what is needed, too
    assert sorted(there - pinned().keys()) == []


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def pinned() -> dict[str, str]:
    """Versions by the canonical name of the package."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line.partition("==") for line in lines if line and not line.startswith("#")]
    assert all(version for _, _, version in pins)
    assert len({canonical(name) for name, _, _ in pins}) == len(pins)
    return {canonical(name): version for name, _, version in pins}


def installed_with_everything() -> set[str]:
    """Canonical names of all that `pip install .[all]` brings here: what is required, and what that requires.

    Of a package that is not installed, what it requires is not known.
    """
    project = SETTINGS["project"]
    queue = [Requirement(line) for line in chain(project["dependencies"], *project["optional-dependencies"].values())]
    queue += [Requirement(line) for line in SETTINGS["build-system"]["requires"]]
    found: set[tuple[str, str]] = set()
    while queue:
        wanted = queue.pop()
        for extra in ("", *wanted.extras):
            key = canonical(wanted.name), extra
            if key in found or key[0] == "lfgpu":
                continue
            found.add(key)
            try:
                lines = importlib.metadata.distribution(wanted.name).requires or []
            except importlib.metadata.PackageNotFoundError:
                continue
            needs = map(Requirement, lines)
            queue += [need for need in needs if need.marker is None or need.marker.evaluate({"extra": extra})]
    return {name for name, _ in found}


CHOSEN = {"docutils": "it is in the public domain, but for a mode of Emacs, which nothing imports"}
"""Packages that name the GPL among several licences, and why they may be needed."""


def licences(name: str) -> list[str]:
    """All that a package says of its licence."""
    about = importlib.metadata.metadata(name)
    said = [about.get("License-Expression") or "", (about.get("License") or "")[:200]]
    return [*said, *(line for line in about.get_all("Classifier") or [] if line.startswith("License ::"))]


def test_nothing_that_is_needed_has_the_gpl() -> None:
    """An MIT package whose dependencies have the GPL is none; the lesser GPL is meant for that."""
    refused = re.compile(r"\bA?GPL|(?<!Lesser )General Public License", re.IGNORECASE)
    assert [text for text in ("GPL-3.0-or-later", "GNU GENERAL PUBLIC LICENSE") if not refused.search(text)] == []
    assert refused.search("LGPL-2.1") is refused.search("GNU Lesser General Public License") is None
    found = {}
    for name in sorted(installed_with_everything()):
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = licences(name)
    assert {"numpy", "pillow", "viser", "dask"} <= found.keys()
    assert {name for name, texts in found.items() if any(map(refused.search, texts))} <= CHOSEN.keys(), found


def test_metadata_are_those_of_the_project() -> None:
    urls = SETTINGS["project"]["urls"]
    assert set(urls) == {"Repository", "Documentation", "Changelog", "Issues"}
    for url in urls.values():
        assert url.startswith(("https://github.com/lfgpu/lfgpu", "https://lfgpu.github.io/lfgpu"))
        _, blob, path = url.partition("/blob/main/")
        assert not blob or (ROOT / path).is_file()
    assert SETTINGS["project"]["scripts"].keys() == {"lfgpu"}
    assert callable(pkgutil.resolve_name(SETTINGS["project"]["scripts"]["lfgpu"]))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for text in (SETTINGS["project"]["description"], lfgpu.__doc__ or "", readme):
        for method in METHODS:
            assert method in text, text
    for preset in PRESETS:
        for stage in method_of(preset).STAGES:
            assert f"`{stage.name}`" in (DepthResult.__doc__ or ""), stage.name


def test_backends_have_files_of_the_same_names() -> None:
    """So that a kernel's versions are found at once; a backend may have more of its own, and Taichi has no streams."""
    streams = {"motion.py", "streaming.py"}
    reference = {path.name for path in (ROOT / "kernels" / "reference").glob("*.py")}
    assert "backend.py" in reference
    for backend in _backends._PACKAGES:
        needed = reference - streams if backend == "taichi" else reference
        assert needed <= {path.name for path in (ROOT / "kernels" / backend).glob("*.py")}, backend


def test_one_version_everywhere() -> None:
    """A release is one number: in the package, in the citation and at the top of the changelog."""
    yaml = pytest.importorskip("yaml", reason="CITATION.cff is YAML: pip install 'lfgpu[calibration]'")
    version = SETTINGS["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == version
    assert citation["license"] == SETTINGS["project"]["license"]
    first = re.search(r"^## (\S+) \((.*)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert first[1] == version.partition(".dev")[0]
    assert (first[2] == "unreleased") == (".dev" in version)


# --- what importing costs ---


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        ("import lfgpu; lfgpu.__version__", HEAVY | {"numpy"}),
        ("import lfgpu; lfgpu.Config; lfgpu.LightField; lfgpu.PRESETS", HEAVY),
    ],
)
def test_import_loads_nothing_heavy(statement: str, heavy: set[str], tmp_path: Path) -> None:
    done = run_python(f"{statement}; import sys; print(*sys.modules, sep='\\n')", tmp_path)
    assert done.returncode == 0, done.stderr
    loaded = {module.partition(".")[0] for module in done.stdout.split()}
    assert not loaded & heavy


def test_an_estimate_and_its_picture_load_neither_scipy_nor_matplotlib(tmp_path: Path) -> None:
    done = run_python(
        "import lfgpu, numpy, sys; views = numpy.random.default_rng(1).random((3, 3, 32, 32, 1), numpy.float32)\n"
        "lf = lfgpu.LightField.from_grid(views)\n"
        "result = lfgpu.estimate_depth(lf, config='fast', disparity_range=(-1, 1), device='cpu')\n"
        "from lfgpu.viz.pictures import write_disparity\n"
        "write_disparity(result.disparity, 'map.png', name='noise'); print(*sys.modules)",
        tmp_path,
    )
    loaded = {module.partition(".")[0] for module in done.stdout.split()}
    assert "warp" in loaded
    assert not loaded & {"scipy", "matplotlib"}


def test_public_names_are_listed_and_there(tmp_path: Path) -> None:
    code = "import lfgpu; lfgpu.calibration.refine, lfgpu.metrics.sparsification; "
    done = run_python(f"{code}print(all(getattr(lfgpu, name) is not None for name in lfgpu.__all__))", tmp_path)
    assert done.stdout.strip() == "True", done.stderr
    assert set(re.findall(r"\b(\w+) as \1\b", Path(lfgpu.__file__).read_text())) == set(lfgpu.__all__)
    assert dir(lfgpu) == sorted(lfgpu.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = lfgpu.nothing
    assert lfgpu.DepthPipeline is DepthPipeline


@pytest.mark.parametrize("name", ["calibration", "contract", "io", "scenes", "viewer"])
def test_type_checkers_of_users_see_what_a_package_offers(name: str) -> None:
    package = importlib.import_module(f"lfgpu.{name}")
    assert all(hasattr(package, offered) for offered in package.__all__)


def test_kernels_are_not_imported_by_another_name() -> None:
    done = run_python("import kernels", ROOT)
    assert done.returncode != 0
    assert "ImportError: the folder kernels/ is the package lfgpu.kernels" in done.stderr


# --- which way imports go ---


def test_host_code_loads_no_backend_when_it_is_imported(tmp_path: Path) -> None:
    """All modules of the host, one after the other, in a process that then has neither a backend nor its package.

    Training works on Warp and PyTorch alone, and no other room imports it.
    """
    code = """
import pkgutil, sys, lfgpu
for module in pkgutil.walk_packages(lfgpu.__path__, "lfgpu."):
    if not module.name.startswith(("lfgpu.kernels", "lfgpu.training", "lfgpu.__main__")):
        __import__(module.name)
print(*sys.modules)
"""
    done = run_python(code, tmp_path)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    assert "lfgpu.methods.matching.plan" in loaded
    assert not {name for name in loaded if name.split(".")[0] in ("warp", "taichi") or "lfgpu.kernels." in name}


# --- a stranger's first contribution ---


def test_contributions_meet_the_checks_of_every_machine() -> None:
    """The workflow calls `.ci/run`; hooks and templates name commands that the Makefile has."""
    yaml = pytest.importorskip("yaml", reason="workflows are YAML: pip install 'lfgpu[calibration]'")
    for path in [*(ROOT / ".github").rglob("*.yml"), ROOT / ".pre-commit-config.yaml"]:
        assert yaml.safe_load(path.read_text(encoding="utf-8")), path
    steps = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))["jobs"]["checks"]["steps"]
    assert ".ci/run" in [step.get("run") for step in steps]
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    lint = (ROOT / "Makefile").read_text(encoding="utf-8").partition("lint:")[2].partition("\n\n")[0]
    for hook in hooks:
        assert hook["entry"].removeprefix(".venv/").replace(" --fix", "").replace("bin", "$(BIN)") in lint
    template = (ROOT / ".github/pull_request_template.md").read_text(encoding="utf-8")
    for rule in re.findall(r"`make (\w+)`", template):
        assert f"\n{rule}:" in (ROOT / "Makefile").read_text(encoding="utf-8")


CONTENT = {
    "date": "2026-01-02T03:04",
    "rows": [{"name": "a b", "n": 1, "ms": 0.1234}, {"name": "a c", "n": 2, "ms": 5.0}],
}
MARKED = (
    "MSE <!-- figure: run.json rows/name=a?b/ms 1000*.1f -->{}<!-- /figure --> of "
    "<!-- figure: run.json date .10 -->2026-01-02<!-- /figure -->\n"
)


def fresh() -> str:
    """Return a result file that was measured with the code that is here."""
    return json.dumps({**CONTENT, "sources": sources.stamp("flicker")})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of results with one file."""
    (tmp_path / "run.json").write_text(fresh(), encoding="utf-8")
    return tmp_path


def page_of(folder: Path, text: str) -> Path:
    page = folder / "README.md"
    page.write_text(text, encoding="utf-8")
    return page


# --- the pages ---


def test_figures_are_those_of_result_files_and_each_is_on_a_page() -> None:
    found = [mark for page in figures.pages() for mark in figures.marks(page)]
    differing = figures.listing([mark for mark in found if mark.found != mark.wanted])
    assert not differing, "run: python -m benchmarks figures"
    assert {"README.md", "batch.md"} <= {mark.page.name for mark in found}
    text = "".join(page.read_text(encoding="utf-8") for page in figures.pages())
    sources = " ".join(mark.source for mark in found)
    assert [path.name for path in FOLDER.glob("*.json") if path.name not in text + sources] == []
    names = ["accuracy-0.2.json", "accuracy-0.10.json", "accuracy-0.1.json"]
    assert pages.newest(names) == "accuracy-0.10.json"
    assert pages.newest(path.name for path in FOLDER.glob("accuracy-*.json")) == pages.ACCURACY


def test_figures_and_tables_are_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, make = pages.TABLES["compared"]
    table = make(*(FOLDER / name for name in files))
    accuracy, learned, _ = (json.loads((FOLDER / name).read_text(encoding="utf-8")) for name in files)
    ours = {r["details"]["preset"] for run in (accuracy, learned) for r in run["records"]}
    others = json.loads((FOLDER / pages.PUBLISHED).read_text(encoding="utf-8"))["methods"]
    assert len(re.findall(r"^\| ", table, re.MULTILINE)) == 2 + len(ours) + len(others)
    assert all(method["source"] and f"| {method['name']} |" in table for method in others)
    assert f"{learned['machine']['cores']} cores" in table.splitlines()[-1]
    page = page_of(folder, MARKED.format("0.5"))
    first, second = figures.marks(page, folder)
    assert (first.found, first.wanted, first.source) == ("0.5", "123.4", "run.json rows/name=a?b/ms")
    assert second.found == second.wanted == "2026-01-02"
    assert figures.write(folder, folder) == [page]
    assert page.read_text(encoding="utf-8") == MARKED.format("123.4")
    assert figures.write(folder, folder) == []
    table = ("run.json",), lambda path: f"| {figures.value(path.parent, path.name, 'date')} |"
    monkeypatch.setattr(figures, "TABLES", {"dates": table})
    page = page_of(folder, "text\n\n<!-- table: dates -->\nold\n<!-- /table -->\n\nmore\n")
    figures.write(folder, folder)
    wanted = "text\n\n<!-- table: dates -->\n| 2026-01-02T03:04 |\n<!-- /table -->\n\nmore\n"
    assert page.read_text(encoding="utf-8") == wanted


# --- stale files ---


def aged(folder: Path) -> None:
    old = {**CONTENT, "sources": {"benchmark": "flicker", "hash": "0"}}
    (folder / "run.json").write_text(json.dumps(old), encoding="utf-8")


def test_a_page_says_that_a_file_is_stale_until_it_is_measured_again(folder: Path) -> None:
    (folder / "other.json").write_text(fresh(), encoding="utf-8")
    before = "# First\n\nOf <!-- figure: other.json date .4 -->2026<!-- /figure -->.\n\n"
    page = page_of(folder, "---\ntop: 1\n---\n\n" + before + "# Title\n\n" + MARKED.format("123.4"))
    before = page.read_text(encoding="utf-8")
    assert figures.write(folder, folder) == []
    aged(folder)
    differing = [mark for mark in figures.marks(page, folder) if mark.found != mark.wanted]
    assert [(mark.line, mark.source) for mark in differing] == [(11, "run.json")]
    figures.write(folder, folder)
    top, note, rest = re.split(r"<!-- /?stale -->\n", page.read_text(encoding="utf-8"))
    assert "Older than the code: the figures from `run.json`" in note
    assert top + rest.removeprefix("\n") == before
    assert figures.write(folder, folder) == []
    (folder / "run.json").write_text(fresh(), encoding="utf-8")
    figures.write(folder, folder)
    assert page.read_text(encoding="utf-8") == before


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
        sources._content.cache_clear()
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
        missing = [place for place in (f"benchmarks/{benchmark}.py", *places) if not [*sources.ROOT.glob(place)]]
        assert missing == [], benchmark
