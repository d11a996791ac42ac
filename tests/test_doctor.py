"""`lfgpu doctor` says what is here, tries it, and names what does not work; the help shows every command by task."""

import ctypes
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from lfgpu import _backends, machine
from lfgpu._backends import BackendInfo
from lfgpu.cli import app, checkup

ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
REFERENCE = BackendInfo("reference", "numpy", "2.0", ("cpu",))
"""The only backend in most of these tests: it starts at once."""
MAPS: dict[str, Any] = {}
PARTS = checkup.TRIALS


@pytest.fixture(autouse=True)
def estimated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map of the self-test is one for all tests, which change what is done with it; parts are tried where said."""
    true = checkup.estimate_depth

    def once(*arguments: Any, **options: Any) -> Any:
        key = repr(options)
        if key not in MAPS:
            MAPS[key] = true(*arguments, **options)
        return MAPS[key]

    monkeypatch.setattr(checkup, "estimate_depth", once)
    monkeypatch.setattr(checkup, "TRIALS", {})


@pytest.fixture
def only_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkup, "describe_backends", lambda: (REFERENCE,))


def doctor() -> Any:
    return CliRunner().invoke(app, ["doctor"])


@pytest.mark.usefixtures("only_reference")
def test_a_sound_installation() -> None:
    outcome = doctor()
    assert outcome.exit_code == 0, outcome.stderr
    for title in ("Versions", "Devices", "Kernel cache", "Memory", "Optional parts", "Self-test", "Verdict"):
        assert re.search(rf"^{title}$", outcome.stdout, re.MULTILINE), title
    assert "numpy" in outcome.stdout
    assert outcome.stdout.endswith("Everything that is installed works.\n")
    assert re.search(r"reference on cpu +passed in \d+\.\d s, 0\.0\d+ px from the ground truth", outcome.stdout)


@pytest.mark.thorough
def test_all_that_is_here_works(monkeypatch: pytest.MonkeyPatch) -> None:
    """With Taichi, whose start alone takes seconds."""
    monkeypatch.setattr(checkup, "TRIALS", PARTS)
    assert checkup.examine().problems == ()


@pytest.mark.usefixtures("only_reference")
def test_every_part_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkup, "TRIALS", PARTS)
    found = checkup.examine()
    assert [label for label, _ in found.facts["Devices"]] == ["reference"]
    here = (extra for extra in PARTS if extra != "train" or find_spec("torch"))  # which `all` leaves out
    tried = [f"extra {extra}" for extra in here]
    assert [trial.what for trial in found.trials] == ["files", *tried, "reference on cpu"]
    assert found.problems == ()
    assert re.fullmatch(r"[\d.]+ GiB free", dict(found.facts["Memory"])["temporary files"])


def test_the_default_backend_is_held_against_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    warp = BackendInfo("warp", "warp-lang", "1.0", ("cpu",))
    monkeypatch.setattr(checkup, "describe_backends", lambda: (warp, REFERENCE))
    found = checkup.examine()
    assert [trial.what for trial in found.trials][-2:] == ["reference on cpu", "warp on cpu"]
    assert found.trials[-1].from_reference is not None
    assert found.problems == ()
    ((backend, cache),) = found.facts["Kernel cache"]
    assert backend == "warp"
    assert re.search(r", [\d.]+ [GM]iB$", cache)


@pytest.mark.usefixtures("only_reference")
@pytest.mark.parametrize("wrong", [0.1, np.nan])
def test_a_wrong_map_is_a_problem(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    true = checkup.estimate_depth

    def off(*arguments: Any, **options: Any) -> Any:
        result = true(*arguments, **options)
        return replace(result, disparity=result.disparity + np.float32(wrong))

    monkeypatch.setattr(checkup, "estimate_depth", off)
    outcome = doctor()
    assert outcome.exit_code == 1
    assert re.search(r"reference on cpu +failed after", outcome.stdout)
    assert re.search(r"The map by reference on cpu is wrong by (0\.1|nan)\S* px in the median\.", outcome.stdout)


def test_two_backends_that_differ_are_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundredth of a pixel is within what the scene allows, but not between backends."""
    true = checkup.estimate_depth

    def off(*arguments: Any, backend: Any, **options: Any) -> Any:
        result = true(*arguments, backend=backend, **options)
        return replace(result, disparity=result.disparity + np.float32(0.01 * (backend == "warp")))

    warp = BackendInfo("warp", "warp-lang", "1.0", ("cpu",))
    monkeypatch.setattr(checkup, "describe_backends", lambda: (warp, REFERENCE))
    monkeypatch.setattr(checkup, "estimate_depth", off)
    (problem,) = checkup.examine().problems
    assert problem.startswith("The map by warp on cpu is wrong by 0.01")


@pytest.mark.usefixtures("only_reference")
def test_an_estimate_that_raises_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: Any, **options: Any) -> Any:
        raise RuntimeError("the driver\nis gone")

    monkeypatch.setattr(checkup, "estimate_depth", broken)
    assert checkup.examine().problems == ("The estimate by reference on cpu failed: the driver is gone.",)


def test_a_broken_package_is_a_problem_and_one_that_is_not_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = BackendInfo("taichi", "taichi", None, (), "cannot be loaded: No module named 'taichi'", "pip install x")
    broken = BackendInfo("warp", "warp-lang", "1.0", (), "cannot be loaded: OSError: libwarp.so", "pip install y")
    monkeypatch.setattr(checkup, "describe_backends", lambda: (broken, missing, REFERENCE))
    assert checkup.examine().problems == (
        "The backend warp cannot be loaded: OSError: libwarp.so; run: pip install y.",
    )


def test_a_cache_that_cannot_be_written_to_is_a_problem(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setattr(checkup, "describe_backends", lambda: (REFERENCE,))
    monkeypatch.setattr(_backends.load("reference"), "kernel_cache", lambda: str(file / "cache"))
    (problem,) = checkup.examine().problems
    assert problem.startswith(f"The backend reference cannot keep compiled kernels in {file / 'cache'}: make")


@pytest.mark.usefixtures("only_reference")
@pytest.mark.parametrize(("extra", "module", "name"), [("exr", "OpenEXR", "File"), ("hdf5", "h5py", "File")])
def test_a_library_that_does_not_fit_is_a_problem(
    extra: str, module: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def old(*_: Any, **__: Any) -> None:
        raise TypeError("an unexpected argument")

    monkeypatch.setattr(checkup, "TRIALS", {extra: PARTS[extra]})
    monkeypatch.setattr(f"{module}.{name}", old)
    (problem,) = checkup.examine().problems
    assert re.fullmatch(
        rf"The part {extra} does not work with {module} \S+ \(.*unexpected argument.*\); .* 'lfgpu\[{extra}\]'\.",
        problem,
        re.IGNORECASE,
    )


@pytest.mark.usefixtures("only_reference")
def test_a_library_that_reads_something_else_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkup, "TRIALS", {part: PARTS[part] for part in ("png", "tiff")})
    monkeypatch.setattr("lfgpu.cli.checkup.read_image", lambda path: (np.zeros((64, 80, 3)), frozenset()))
    png, tiff = checkup.examine().problems
    assert png.startswith("The part png does not work with imagecodecs")
    assert "what is read differs by" in tiff


def test_parts_that_are_not_there_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert PARTS.keys() | {"taichi"} == checkup.PARTS.keys()
    assert set(checkup.PARTS) == EXTRAS.keys() - {"all", "test", "lint", "docs"}
    monkeypatch.setattr(checkup, "describe_backends", lambda: (REFERENCE,))
    monkeypatch.setattr(checkup, "version_of", lambda name: None if name in ("torch", "viser") else "1.0")
    outcome = doctor()
    assert outcome.exit_code == 0
    assert "not installed: the viewer in the browser; pip install 'lfgpu[viewer]'" in outcome.stdout


def test_memory_of_a_gpu_is_what_its_driver_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Driver:
        def cuDeviceTotalMem_v2(self, size: Any, device: Any) -> int:  # noqa: N802  # the name in the driver
            size._obj.value = 80 * 2**30
            return int(device.value != 1)

    monkeypatch.setattr(machine, "_cuda", lambda index: (Driver(), ctypes.c_int(index)))
    assert machine.device_memory("cuda:1") == 80 * 2**30
    assert machine.device_memory("cuda:0") is None  # an error of the driver
    assert machine.device_memory("cpu") is None
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal:       24684092 kB\nMemAvailable:   20000000 kB\n")
    monkeypatch.setattr(machine, "_MEMINFO", meminfo)
    assert machine.free_memory() == 20000000 * 1024
    monkeypatch.setattr(machine, "_MEMINFO", tmp_path / "nowhere")
    assert machine.free_memory() is None


# --- help and completion ---


def commands() -> dict[str, Any]:
    return typer.main.get_command(app).commands  # type: ignore[attr-defined,no-any-return]


def test_help_shows_every_command_by_task_with_its_example() -> None:
    shown = CliRunner().invoke(app, ["--help"], terminal_width=120).stdout
    panels = re.findall(r"╭─ ([\w ]+) ─", shown)
    assert panels == ["Options", "Begin", "Read", "Estimate", "Look and use", "Look up"]
    for name in commands():
        assert re.search(rf"^│ {name} ", shown, re.MULTILINE), name
        assert f"$ lfgpu {name}" in shown


@pytest.mark.parametrize("name", sorted(commands()))
def test_the_example_of_a_command_is_one(name: str) -> None:
    """Its options exist and take these values. A new option or command that breaks it fails here."""
    command = commands()[name]
    program, called, *arguments = shlex.split(command.epilog.removeprefix("Example: "))
    assert (program, called) == ("lfgpu", name)
    command.make_context(name, arguments)  # raises where something is unknown or missing


def test_completion_names_the_commands() -> None:
    variables = {**os.environ, "_LFGPU_COMPLETE": "complete_bash", "COMP_WORDS": "lfgpu de", "COMP_CWORD": "1"}
    done = subprocess.run(
        [sys.executable, "-c", "from lfgpu.cli import main; main()"],
        env=variables, cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert {"depth", "decode", "demo"} == set(done.stdout.split()), done.stderr
