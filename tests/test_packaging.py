"""The package: its files, its requirements, and the cost of importing it."""

import importlib.metadata
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

from lfgpu import _backends

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
HOST = sorted((ROOT / "lfgpu").rglob("*.py"))
KERNELS = sorted((ROOT / "kernels").rglob("*.py"))
HEAVY = {"warp", "taichi", "matplotlib", "typer", "rich", "scipy", "imageio", "PIL"}


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def run_python(code: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=600)


def required() -> set[str]:
    """Return the names that pip has for all requirements of lfgpu and its extras."""
    project = SETTINGS["project"]
    lines = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    return {re.match(r"[\w-]+", line)[0] for line in lines} - {"lfgpu"}  # type: ignore[index]


# --- what is installed ---


def test_every_backend_is_a_package_whose_needs_can_be_installed() -> None:
    for backend, package in _backends._PACKAGES.items():
        assert (ROOT / "kernels" / backend / "__init__.py").is_file()
        assert package in required()


def test_all_is_every_extra() -> None:
    extras = SETTINGS["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    large = {"train"}  # PyTorch: only who trains needs it
    assert set(everything.removeprefix("lfgpu[").removesuffix("]").split(",")) == extras.keys() - {"all"} - large


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


def test_what_is_installed_with_the_project_is_pinned() -> None:
    there = installed_with_everything()
    assert {"numpy", "pydantic-core", "hatchling", "websockets"} <= there  # needed by what is needed, too
    assert sorted(there - pinned().keys()) == []


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


def test_links_of_the_project_are_given() -> None:
    urls = SETTINGS["project"]["urls"]
    assert set(urls) == {"Repository", "Documentation", "Changelog", "Issues"}
    for url in urls.values():
        assert url.startswith("https://github.com/lfgpu/lfgpu")
        _, blob, path = url.partition("/blob/main/")
        assert not blob or (ROOT / path).is_file()


def test_no_folder_with_code_is_not_a_package() -> None:
    for path in (*HOST, *KERNELS):
        assert (path.parent / "__init__.py").is_file(), name_of(path)


def test_the_command_line_entry_exists() -> None:
    assert SETTINGS["project"]["scripts"].keys() == {"lfgpu"}
    assert callable(pkgutil.resolve_name(SETTINGS["project"]["scripts"]["lfgpu"]))


def test_backends_have_files_of_the_same_names() -> None:
    """So that a kernel's versions are found at once; a backend may have more of its own, and Taichi has no streams."""
    streams = {"motion.py", "streaming.py"}
    reference = {path.name for path in (ROOT / "kernels" / "reference").glob("*.py")}
    assert "backend.py" in reference
    for backend in _backends._PACKAGES:
        needed = reference - streams if backend == "taichi" else reference
        assert needed <= {path.name for path in (ROOT / "kernels" / backend).glob("*.py")}, backend


def test_descriptions_name_the_methods() -> None:
    import lfgpu
    from lfgpu.methods import METHODS

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for text in (SETTINGS["project"]["description"], lfgpu.__doc__ or "", readme):
        for method in METHODS:
            assert method in text, text


def test_the_stages_of_results_are_described() -> None:
    from lfgpu.data.result import DepthResult
    from lfgpu.methods import PRESETS, method_of

    for preset in PRESETS:
        for stage in method_of(preset).STAGES:
            assert f"`{stage.name}`" in (DepthResult.__doc__ or ""), stage.name


def test_one_version_everywhere() -> None:
    """A release is one number: in the package, in the citation and at the top of the changelog."""
    yaml = pytest.importorskip("yaml", reason="CITATION.cff is YAML: pip install 'lfgpu[calibration]'")
    version = SETTINGS["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == version
    assert citation["license"] == SETTINGS["project"]["license"]
    first = re.search(r"^## (\S+) \((.*)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert first is not None
    assert first[1] == version.partition(".dev")[0]
    assert (first[2] == "unreleased") == (".dev" in version)


# --- what importing costs ---


@pytest.mark.parametrize("statement", ["import lfgpu", "import lfgpu; lfgpu.Config; lfgpu.LightField; lfgpu.PRESETS"])
def test_import_loads_nothing_heavy(statement: str, tmp_path: Path) -> None:
    done = run_python(f"{statement}; import sys; print(*sys.modules, sep='\\n')", tmp_path)
    assert done.returncode == 0, done.stderr
    loaded = {module.partition(".")[0] for module in done.stdout.split()}
    assert not loaded & HEAVY


def test_import_loads_few_modules(tmp_path: Path) -> None:
    done = run_python(
        "import sys; before = set(sys.modules); import lfgpu; print(len(set(sys.modules) - before))", tmp_path
    )
    assert int(done.stdout) < 60


def test_an_estimate_loads_neither_scipy_nor_matplotlib(tmp_path: Path) -> None:
    done = run_python(
        "import lfgpu, numpy, sys; views = numpy.random.default_rng(1).random((3, 3, 32, 32, 1), numpy.float32)\n"
        "lf = lfgpu.LightField.from_grid(views)\n"
        "lfgpu.estimate_depth(lf, config='fast', disparity_range=(-1, 1), device='cpu'); print(*sys.modules)",
        tmp_path,
    )
    loaded = {module.partition(".")[0] for module in done.stdout.split()}
    assert "warp" in loaded
    assert not loaded & {"scipy", "matplotlib"}


def test_every_public_name_is_there(tmp_path: Path) -> None:
    done = run_python("import lfgpu; print(all(getattr(lfgpu, name) is not None for name in lfgpu.__all__))", tmp_path)
    assert done.stdout.strip() == "True", done.stderr


def test_public_names_are_listed_and_unknown_ones_are_refused() -> None:
    import lfgpu

    assert set(lfgpu.__all__) == set(lfgpu._HOMES)
    assert dir(lfgpu) == sorted(lfgpu.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = lfgpu.nothing


def test_pipeline_is_public() -> None:
    import lfgpu
    from lfgpu.pipelines.pipeline import DepthPipeline

    assert "DepthPipeline" in lfgpu.__all__
    assert lfgpu.DepthPipeline is DepthPipeline


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
