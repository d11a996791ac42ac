"""Commands that fail say one sentence and leave nothing behind; help and parameters load nothing heavy."""

import errno
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from command_line import OUTPUTS, RANGE, boxes, holes, lfgpu, refused

from lfgpu import Viewer, estimate_depth, export_pipeline, save, scenes, write_report
from lfgpu.calibration import load_pictures, read_calibration, read_rectifier, rectify
from lfgpu.config import Config, Section, number, parameters
from lfgpu.errors import LightFieldError
from lfgpu.io import check_writable, formats, load, read as read_files, read_map, read_mask, recognise, write_hci
from lfgpu.io.formats import FORMATS, Format
from lfgpu.io.frames import write_frames
from lfgpu.methods import METHODS, PRESETS, Entry, preset
from tests.made import made_result, raising


def cut_short(folder: Path) -> None:
    file = folder / "input_Cam007.png"
    file.write_bytes(file.read_bytes()[:400])


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (shutil.rmtree, "does not exist"),
        (cut_short, "input_Cam007.png cannot be read"),
        (holes, "lacks 3 of the 25 views"),
    ],
)
def test_damaged_inputs(damage: Callable[[Path], None], words: str, views: Path, out: Path) -> None:
    damage(views)
    refused(lfgpu("depth", views, "-o", out), words)
    assert not out.parent.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--disparity-range", "2,-2"], "LOW below HIGH"),
        (["--disparity-range=nan,1"], "finite"),
        (["--disparity-range=near,far"], "LOW,HIGH such as -2,2"),
        (["--disparity-range=1,2,3"], "LOW,HIGH such as -2,2"),
        (["--preset", "best"], "unknown preset 'best'"),
        (["--set", "local.nothing=1"], "unknown parameter 'local.nothing'"),
        (["--set", "window"], "stage.parameter=value"),
        (["--set", "prior.window=8"], "must be odd"),
        (["--preset", "paper", "--set", "refinement.solver=magic"], "lbfgs, lbfgsb"),
        (["--backend", "abacus"], "unknown backend 'abacus'"),
        (["--device", "gpu"], "no device 'gpu'; use one of "),
        (["--views", "circle"], "full, star, cross, row, column"),
        (["--format", "hologram"], "unknown format 'hologram'"),
        (["--reference-view", "9,0"], "no view at row 9, column 0"),
        (["--reference-view", "middle"], "ROW,COL such as 4,4"),
        (["--reference-view", "nan,1"], "finite"),
        (["--every=0"], "every must be a whole number of at least 1, not 0"),
        (["--frame=0"], "for which frame means nothing"),
    ],
)
def test_wrong_options(options: list[str], words: str, recorded: Path, out: Path) -> None:
    refused(lfgpu("depth", recorded, "-o", out, *options), words)
    assert not out.parent.exists()


def test_options_are_checked_before_anything_is_read(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.io.read", pytest.fail)
    for option in ("--disparity-range=2,1", "--preset=x", "--set=x", "--backend=x", "--device=x", "--views=x"):
        refused(lfgpu("depth", "anywhere", "-o", out, option), "x" if option.endswith("x") else "range")


def test_output_that_cannot_be_written(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.pipelines.estimate.estimate_depth", pytest.fail)  # found out before the long computation
    (tmp_path / "file").write_text("mine")
    refused(lfgpu("depth", recorded, "-o", tmp_path / "file"), "is a file, not a folder")
    refused(lfgpu("depth", recorded, "-o", tmp_path / "file" / "out"), "is a file, not a folder")
    assert (tmp_path / "file").read_text() == "mine"


def test_missing_output_is_wrong_usage(recorded: Path) -> None:
    outcome = lfgpu("depth", recorded)
    assert outcome.code == 2
    assert "--out" in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("depth lf -o ", "-o"),
        ("depth lf --out=", "--out"),
        ("live lf -o out --record ", "--record"),
        ("info ", "an argument"),
        ("batch lf  -o out", "an argument"),
        ("info -- ", "an argument"),
        ("depth lf -o out --pattern ", "--pattern"),
    ],
)
def test_an_empty_name_is_not_the_current_folder(
    words: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_hci(boxes(), "lf")
    found = lfgpu(*words.split(" "))
    assert found.code == 2
    assert f"Invalid value for {name}: it is empty" in found.err
    assert [path.name for path in tmp_path.iterdir()] == ["lf"]
    assert lfgpu("info", "lf", "--flip", "").code == 0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("", "the path is empty; name a file or a folder"),
        ("a\0b", r"without zero bytes, .*, not 'a\\x00b'\."),
        ("a\ud800b", r"must be a name that files can have, not 'a\\ud800b'\."),
    ],
)
def test_names_that_no_file_can_have_are_refused(
    name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for call in (partial(write_hci, boxes()), read_files, load, check_writable, partial(write_frames, [])):
        with pytest.raises(LightFieldError, match=words):
            call(name)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_path_is_refused(recorded: Path) -> None:
    lf = boxes()
    assert lf.truth is not None
    result = made_result(lf.truth.disparity, position=(2.0, 2.0))
    calls: tuple[Callable[[Any], object], ...] = (
        read_files,
        load,
        result.save,
        partial(save, result.map),
        read_map,
        read_mask,
        recognise,
        partial(write_report, lf=lf, result=result),
        partial(export_pipeline, lf),
        partial(write_hci, lf),
        partial(write_frames, []),
        lambda path: Viewer.of([path], port=0),
        lambda path: rectify(recorded, calibration=path or 5),
        rectify,
        read_calibration,
        read_rectifier,
        load_pictures,
        lambda path: estimate_depth(lf, weights=path or 5),
    )
    for call in calls:
        for wrong in (None, 5):
            with pytest.raises(LightFieldError, match=r"path must name a file or a folder, not (None|5)\."):
                call(wrong)


@pytest.mark.parametrize(
    "where", ["lfgpu.methods.matching.aggregation.SemiGlobal.__call__", "lfgpu.cli.outputs.save", "lfgpu.io.read"]
)
def test_interruption_leaves_nothing(
    where: str, recorded: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, raising(KeyboardInterrupt()))
    refused(lfgpu("depth", recorded, "-o", out, *RANGE), "interrupted; outputs are whole or not there", code=130)
    assert not list(tmp_path.iterdir())


def test_an_interruption_after_writing_does_not_say_that_nothing_was_written(
    recorded: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.cli.console.output", raising(KeyboardInterrupt()))
    refused(lfgpu("depth", recorded, "-o", out, *RANGE), "interrupted; outputs are whole or not there", code=130)
    assert {path.name for path in out.iterdir()} == OUTPUTS


DROPPING = """
import signal, sys, threading
import lfgpu.io
from lfgpu.cli import main

class Dropping:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)  # Python drops what it raises here

def read(*_, **__):
    Dropping()
    threading.Event().wait(60)

lfgpu.io.read = read
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="processes send no Ctrl-C there")
def test_an_interruption_that_comes_in_a_destructor_comes_again(recorded: Path, out: Path) -> None:
    """In a process of its own: hooks and signals belong to a process, and test runners have some as well."""
    command = [sys.executable, "-c", DROPPING, "depth", str(recorded), "-o", str(out), *RANGE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert (done.stdout, done.stderr) == ("", "lfgpu: interrupted; outputs are whole or not there.\n")


def test_an_interruption_while_commands_are_loaded_is_one_sentence() -> None:
    code = (
        "import sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'lfgpu.cli':\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "import runpy\n"
        "runpy.run_module('lfgpu', run_name='__main__')\n"
    )
    found = python("-c", code)
    assert (found.returncode, found.stderr) == (130, "lfgpu: interrupted; nothing was done.\n")


def test_what_fails_after_an_interruption_is_not_its_cause(
    recorded: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*_: object, **__: object) -> None:
        try:
            raise KeyboardInterrupt
        finally:
            raise LightFieldError("a.png is truncated.")

    monkeypatch.setattr("lfgpu.io.read", read)
    refused(lfgpu("depth", recorded, "-o", out, *RANGE), "interrupted; outputs are whole or not there", code=130)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "lfgpu: out of memory; use fewer or smaller views, --views cross or --max-memory."),
        (
            RuntimeError("Failed to allocate 123 bytes on device 'cuda:0'"),
            "out of memory on the device; use fewer or smaller views, --views cross, --max-memory or --device cpu.",
        ),
        (
            RuntimeError("CUDA error 700: an illegal address"),
            "lfgpu: the GPU failed (CUDA error 700: an illegal address)",
        ),
        (PermissionError(errno.EACCES, "Permission denied", "/views/a.png"), "/views/a.png: Permission denied"),
        (LightFieldError("a sentence\nover two lines."), "a sentence over two lines."),
    ],
)
def test_errors_of_the_machine(
    error: Exception, words: str, recorded: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.pipelines.estimate.estimate_depth", raising(error))
    refused(lfgpu("depth", recorded, "-o", out), words)


def test_memory_is_saved_by_options_that_the_command_has(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.scenes.make", raising(MemoryError()))
    refused(lfgpu("scene", "boxes", "-o", out), "out of memory; use fewer or smaller views.")


def test_full_disk_leaves_nothing(recorded: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.cli.outputs.save", raising(OSError(errno.ENOSPC, "No space left on device")))
    refused(lfgpu("depth", recorded, "-o", out, *RANGE), "No space left on device")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [ZeroDivisionError(), RuntimeError("a bug")])
def test_bugs_keep_their_traceback(
    error: Exception, recorded: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.pipelines.estimate.estimate_depth", raising(error))
    assert lfgpu("depth", recorded, "-o", out).raised is error


def test_a_range_may_be_two_numbers(recorded: Path, tmp_path: Path) -> None:
    for pair in (("-2", "2"), ("-2,2",)):
        outcome = lfgpu("depth", recorded, "--disparity-range", *pair, "--preset", "fast", "-q", "-o", tmp_path / "out")
        assert outcome.code == 0


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
    ("commands", "heavy"),
    [
        (["--help", "backends --help", "parameters --help", "parameters --preset paper", "depth --nonsense"], LIGHTER),
        (["depth --help", "live --help", "export --help"], LIGHT),  # of the formats, whose readers need NumPy
    ],
    ids=["lighter", "light"],
)
def test_help_loads_nothing_heavy(commands: list[str], heavy: set[str]) -> None:
    script = (
        f"import sys\nfrom lfgpu.cli import main\nfor command in {commands}:\n"
        "    sys.argv = ['lfgpu', *command.split()]\n"
        "    try:\n        main()\n    except SystemExit as end:\n"
        "        assert (end.code or 0) == 2 * ('nonsense' in command), command\n"
        f"heavy = {heavy} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = python("-c", script)
    assert done.returncode == 0, done.stderr


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


def test_a_terminal_is_told_what_goes_on(recorded: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the start, when kernels may be compiled for a minute, to the last stage."""
    command = "depth", recorded, "-o", out, *RANGE, "--preset", "fast"
    assert lfgpu(*command).err == ""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    shown = lfgpu(*command).err
    assert "range and noise; the first run compiles kernels" in shown
    assert "boundaries" in shown


def test_an_unknown_preset_has_no_parameters() -> None:
    refused(lfgpu("parameters", "--preset", "fats"), "unknown preset 'fats'; use one of accurate, fast, learned, ")


def test_commands_need_no_backend_that_matplotlib_knows() -> None:
    code = (
        "import contextlib, sys; from lfgpu.cli import main; sys.argv = ['lfgpu', '--version']\n"
        "with contextlib.suppress(SystemExit): main()\n"
        "import lfgpu.reports.charts"
    )
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="shells cannot close a stream there")
def test_an_estimate_needs_no_stderr(tmp_path: Path) -> None:
    """A program without a console has none: neither a stream of Python nor a descriptor."""
    code = (
        "import lfgpu\nlf = lfgpu.scenes.make('planes', size=(32, 32))\n"
        "print(lfgpu.estimate_depth(lf, config='fast').disparity.shape)"
    )
    command = ["sh", "-c", '"$0" -c "$1" 2>&-', sys.executable, code]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout == "(32, 32)\n"
