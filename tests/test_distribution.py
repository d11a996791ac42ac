"""Releases work: the archive of sources can be tested, the wheel runs where there is no checkout."""

import os
import subprocess
import sys
import tarfile
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough

pytest.importorskip("hatchling", reason="nothing can be built without hatchling: pip install 'lfgpu[test]'")

ROOT = Path(__file__).parents[1]
CODE = {path for folder in ("lfgpu", "kernels") for path in (ROOT / folder).rglob("*.py")}
TESTED_WITH = (
    "Makefile",
    "constraints.txt",
    "README.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "pyproject.toml",
)
FOLDERS = ("lfgpu", "kernels", "tests", "benchmarks", "docs", "examples")


def run(command: Sequence[str | Path], cwd: Path) -> str:
    """Return the output of a command in the environment of these tests, from which this checkout cannot be seen."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYTEST"))}
    variables = {**inherited, "PYTHONNOUSERSITE": "1"}
    done = subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


class Environment:
    """A virtual environment that sees the packages of this one, but not the lfgpu that these tests are of.

    Its own packages come first. Those of this environment follow as a plain folder, whose .pth files, and with them an
    editable lfgpu, do not count.
    """

    def __init__(self, folder: Path) -> None:
        venv.create(folder, symlinks=os.name != "nt")
        self.folder = folder
        self.programs = folder / ("Scripts" if os.name == "nt" else "bin")
        self.python = self.programs / "python"
        shared = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
        packages = run([self.python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder).strip()
        (Path(packages) / "zz_shared.pth").write_text("\n".join(shared) + "\n")

    def install(self, *arguments: str | Path) -> None:
        options = ("--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check")
        run([sys.executable, "-m", "pip", "--python", self.python, "install", *options, *arguments], self.folder)

    def python_says(self, code: str, cwd: Path) -> list[str]:
        return run([self.python, "-c", code], cwd).splitlines()


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The archive of sources, unpacked."""
    folder = tmp_path_factory.mktemp("sdist")
    run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(folder)], ROOT)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        packed.extractall(folder, filter="data")
    return folder / archive.name.removesuffix(".tar.gz")


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the archive of sources."""
    folder = tmp_path_factory.mktemp("wheel")
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)], sdist)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """An environment in which lfgpu is what the wheel holds."""
    environment = Environment(tmp_path_factory.mktemp("installed"))
    environment.install(wheel)
    return environment


@pytest.fixture(scope="module")
def editable(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Environment, Path]:
    """An environment with an editable install of a copy named `lfgpu`, and the folder in which that copy lies."""
    environment = Environment(tmp_path_factory.mktemp("editable"))
    parent = tmp_path_factory.mktemp("parent")
    with tarfile.open(next(sdist.parent.glob("*.tar.gz"))) as packed:
        packed.extractall(parent, filter="data")
    (parent / sdist.name).rename(parent / "lfgpu")
    environment.install("--editable", parent / "lfgpu")
    return environment, parent


# --- the archive of sources ---


def test_the_archive_of_sources_has_all_that_tests_need(sdist: Path) -> None:
    for name in TESTED_WITH:
        assert (sdist / name).read_bytes() == (ROOT / name).read_bytes(), name
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            made = "__pycache__" in path.parts or "made" in path.parts  # docs/made: pages that `make docs` writes
            if path.is_file() and not made:
                name = path.relative_to(ROOT)
                assert (sdist / name).is_file(), name


def test_tests_run_on_the_archive_of_sources(sdist: Path) -> None:
    (sdist / "tests" / "test_here.py").write_text(
        "import lfgpu, lfgpu.kernels.warp\nfrom pathlib import Path\n"
        "def test_here():\n"
        f"    assert Path(lfgpu.__file__).is_relative_to({str(sdist)!r})\n"
        f"    assert Path(lfgpu.kernels.warp.__file__).is_relative_to({str(sdist)!r})\n"
    )
    tests = ("tests/test_here.py", "tests/test_arrows.py", "tests/test_metrics.py")
    run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests], sdist)
    (sdist / "tests" / "test_here.py").unlink()


# --- the wheel ---


def test_the_wheel_has_the_code_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    shim = ROOT / "lfgpu" / "kernels.py"
    expected = {path.relative_to(ROOT) for path in CODE - {shim}}
    expected |= {Path("lfgpu/kernels/warp/native", path.name) for path in (ROOT / "kernels/warp/native").iterdir()}
    weights = {Path(f"lfgpu/methods/matching/{name}.npz") for name in ("weights", "choice", "windows")}
    expected |= {Path("lfgpu/py.typed"), *weights} | {
        path.relative_to(ROOT) for path in (ROOT / "lfgpu" / "native").iterdir()
    }
    expected |= {path.relative_to(ROOT) for path in (ROOT / "lfgpu" / "templates").glob("*.html")}
    page = (ROOT / "lfgpu" / "viewer" / "page").rglob("*")
    expected |= {path.relative_to(ROOT) for path in page if path.is_file()}
    moved = {Path("lfgpu", path) if path.parts[0] == "kernels" else path for path in expected}
    assert names == {path.as_posix() for path in moved}


def test_the_wheel_estimates_reports_and_exports(installed: Environment, tmp_path: Path) -> None:
    """From a folder that has nothing to do with the checkout, by the command that the wheel installs."""
    found = installed.python_says(
        "import importlib.metadata as m, lfgpu, lfgpu.kernels.warp as k\n"
        "print(lfgpu.__file__, k.__file__, m.distribution('lfgpu').locate_file(''), sep='\\n')",
        tmp_path,
    )
    assert all(Path(line).is_relative_to(installed.folder) for line in found), found

    program = installed.programs / "lfgpu"
    run([program, "scene", "boxes", "-o", "lf", "--grid", "3x3", "--size", "40x48"], tmp_path)
    common = ("--preset", "fast", "--disparity-range", "-1.5,1.5", "--device", "cpu")
    run([program, "depth", "lf", "-o", "out", *common, "--report"], tmp_path)
    run([program, "export", "lf", "-o", "exported", *common], tmp_path)
    assert {"disparity.pfm", "result.npz", "report.html"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert "<html" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert (tmp_path / "exported" / "replay.cpp").read_bytes() == (ROOT / "lfgpu/native/replay.cpp").read_bytes()
    error = installed.python_says(
        "import lfgpu, numpy as np\n"
        "lf, found = lfgpu.read('lf'), lfgpu.load('out/result.npz')\n"
        "print(np.median(np.abs(found.disparity - lf.truth.disparity)))",
        tmp_path,
    )
    assert float(error[0]) < 0.07


USER = """
import lfgpu

lf = lfgpu.read("folder")
result = lfgpu.estimate_depth(lf, disparity_range=(-1.0, 1.0))
print(result.disparity.shape)
lfgpu.estimate_depth(lf, disparity_range="wide")
"""


def check_types(environment: Environment, folder: Path) -> None:
    """mypy accepts a user's file but for the last line, which is wrong."""
    (folder / "user.py").write_text(USER)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--python-executable", environment.python, "user.py"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": "", "MYPYPATH": ""},
        capture_output=True,
        text=True,
    )
    wrong = 'user.py:7: error: Argument "disparity_range" to "estimate_depth" has incompatible type "str"'
    assert done.stdout.startswith(wrong), done.stdout + done.stderr
    assert "Found 1 error in 1 file" in done.stdout


def test_types_of_the_wheel_are_seen(installed: Environment, tmp_path: Path) -> None:
    check_types(installed, tmp_path)


# --- the editable install ---


def test_a_clone_named_lfgpu_does_not_hide_the_package(editable: tuple[Environment, Path]) -> None:
    """In the folder that holds the clone, `lfgpu` without more is the clone's folder, which is no package."""
    environment, parent = editable
    found = environment.python_says(
        "import lfgpu, lfgpu.kernels.warp as k; print(lfgpu.estimate_depth.__module__, lfgpu.__file__, k.__file__)",
        parent,
    )
    inner = parent / "lfgpu"
    expected = f"lfgpu.pipelines.estimate {inner / 'lfgpu/__init__.py'} {inner / 'kernels/warp/__init__.py'}"
    assert found == [expected]


def test_types_are_seen_beside_a_clone_named_lfgpu(editable: tuple[Environment, Path]) -> None:
    check_types(*editable)


def test_a_new_file_of_an_editable_install_is_found_at_once(editable: tuple[Environment, Path], tmp_path: Path) -> None:
    environment, parent = editable
    for folder, module in (("lfgpu/io", "lfgpu.io"), ("kernels/reference", "lfgpu.kernels.reference")):
        (parent / "lfgpu" / folder / "brand_new.py").write_text("VALUE = 5\n")
        code = f"from {module} import brand_new; print(brand_new.VALUE)"
        assert environment.python_says(code, tmp_path) == ["5"]
