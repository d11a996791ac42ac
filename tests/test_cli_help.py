"""The command line as a process: help and lists of parameters, and that they load nothing heavy."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from command_line import lfgpu, refused

from lfgpu import list_backends, scenes
from lfgpu.config import Config, Section, number, parameters
from lfgpu.io import formats
from lfgpu.io.formats import FORMATS, Format
from lfgpu.methods import METHODS, PRESETS, Entry, preset


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "COLUMNS": "80"}
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, check=False)


def test_as_a_module() -> None:
    done = python("-m", "lfgpu", "--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"lfgpu \d+\.\d+\.\d+\S*\n", done.stdout)


def test_a_mistake_in_a_process_of_its_own(tmp_path: Path) -> None:
    done = python("-m", "lfgpu", "depth", str(tmp_path / "nowhere"), "-o", str(tmp_path / "out"))
    assert done.returncode == 1
    assert re.fullmatch(r"lfgpu: .* does not exist; [^\n]*\.\n", done.stderr)
    assert not (tmp_path / "out").exists()


LIGHT = {"matplotlib", "warp", "taichi", "imageio", "viser", "distributed"}
LIGHTER = LIGHT | {"numpy", "scipy", "PIL"}


@pytest.mark.parametrize(
    ("arguments", "code", "heavy"),
    [
        (["--help"], 0, LIGHTER),
        (["backends", "--help"], 0, LIGHTER),
        (["parameters", "--help"], 0, LIGHTER),
        (["parameters", "--preset", "paper"], 0, LIGHTER),
        (["depth", "--nonsense"], 2, LIGHTER),
        (["depth", "--help"], 0, LIGHT),  # lists the formats, whose readers need NumPy
        (["live", "--help"], 0, LIGHT),
        (["export", "--help"], 0, LIGHT),
    ],
)
def test_help_loads_nothing_heavy(arguments: list[str], code: int, heavy: set[str]) -> None:
    script = (
        f"import sys\nfrom lfgpu.cli import main\nsys.argv = ['lfgpu', *{arguments}]\n"
        f"try:\n    main()\nexcept SystemExit as end:\n    assert not end.code if {code} == 0 else end.code == {code}\n"
        f"heavy = {heavy} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = python("-c", script)
    assert done.returncode == 0, done.stderr


def test_help_lists_presets_formats_and_backends() -> None:
    shown = " ".join(lfgpu("depth", "--help").out.replace("│", " ").split())
    assert "--disparity-range" in shown
    assert "lfgpu parameters" in shown
    for name, label in (item for entry in METHODS.values() for item in entry.labels.items()):
        assert f"{name}: {label}" in shown
    assert ", ".join(entry.name for entry in FORMATS) in shown
    assert ", ".join(list_backends()) in shown


@dataclass(frozen=True)
class ToySection(Section):
    """Knobs of the toy."""

    weight: float = number(0.5, 0.0, 1.0, "weight of nothing, pixels", symbol="ω")


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third method and a further format, registered while a test runs."""
    monkeypatch.setattr(Config, "known", dict(Config.known))

    @dataclass(frozen=True)
    class ToyConfig(Config):
        method = "toy"
        knobs: ToySection = ToySection()

    monkeypatch.setitem(
        METHODS, "toy", Entry(ToyConfig, {"plain": ToyConfig()}, "nowhere:Toy", "does nothing", {"plain": "a toy"})
    )
    monkeypatch.setitem(PRESETS, "plain", ToyConfig())
    more = Format("toy-files", "files of a toy", lambda path: None, lambda path, **_: scenes.make("boxes"))
    monkeypatch.setattr(formats, "FORMATS", (*FORMATS, more))


@pytest.mark.usefixtures("toy")
def test_a_new_method_and_a_new_format_appear_in_the_help_by_themselves() -> None:
    for command in ("depth", "batch"):
        shown = " ".join(lfgpu(command, "--help").out.replace("│", " ").split())
        assert "plain: a toy" in shown
        assert "toy-files" in shown
    assert lfgpu("parameters", "--preset", "plain").out == "knobs.weight\t0.5\t0 to 1\tweight of nothing, pixels\tω\n"


@pytest.mark.parametrize("name", PRESETS)
def test_parameters_in_a_pipe_are_one_line_each_that_set_takes(name: str) -> None:
    shown = lfgpu("parameters", "--preset", name)
    assert (shown.code, shown.err) == (0, "")
    lines = [line.split("\t") for line in shown.out.splitlines()]
    assert [line[0] for line in lines] == list(dict(parameters(PRESETS[name])))
    assert all(len(line) == 5 and all(line[:4]) for line in lines)
    assert preset(name).with_values({line[0]: line[1] for line in lines}) == preset(name)


def test_parameters_tell_range_choices_and_symbol() -> None:
    lines = {line.split("\t")[0]: line.split("\t")[1:] for line in lfgpu("parameters").out.splitlines()}
    assert lines["sweep.views"][:2] == ["alternate", "full, alternate, star, cross"]
    assert lines["prior.window"][:2] == ["9", "3 to 31, odd"]
    assert lines["alignment.iterations"][1] == "1 to 100, integer"
    assert lines["semi_global.small_penalty"][3] == "P1"


def test_parameters_on_a_terminal_are_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    shown = re.sub(r"\x1b\[[0-9;]*m", "", lfgpu("parameters", "--preset", "paper").out)
    assert "\t" not in shown
    assert "paper: Sajjadi et al. 2016, for views with noise and occlusions." in shown
    for name, _ in parameters(PRESETS["paper"]):
        assert len(re.findall(rf"^  {re.escape(name)} ", shown, re.MULTILINE)) == 1
    assert "((views - 1) · channels)]" in " ".join(shown.split())


def test_an_unknown_preset_has_no_parameters() -> None:
    refused(lfgpu("parameters", "--preset", "fats"), "unknown preset 'fats'; use one of accurate, fast, learned, ")
