"""Commands that fail say one sentence and leave nothing behind."""

import errno
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import RANGE, holes, lfgpu, refused
from PIL import Image

from lfgpu.errors import LightFieldError
from lfgpu.io import write_pfm


def keep_one(folder: Path) -> None:
    for file in folder.glob("input_Cam*.png"):
        if file.name != "input_Cam000.png":
            file.unlink()


def empty(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def another_size(folder: Path) -> None:
    Image.new("RGB", (30, 30)).save(folder / "input_Cam007.png")


def cut_short(folder: Path) -> None:
    file = folder / "input_Cam007.png"
    file.write_bytes(file.read_bytes()[:400])


def nan_pixel(folder: Path) -> None:
    empty(folder)
    pixels = np.full((20, 20), 0.5, np.float32)
    for column in range(3):
        Image.fromarray(pixels).save(folder / f"view_0_{column}.tif")
        pixels[3, 4] = np.nan


def another_truth(folder: Path) -> None:
    write_pfm(folder / "gt_disp_lowres.pfm", np.zeros((5, 5)))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (shutil.rmtree, "does not exist"),
        (empty, "an empty folder"),
        (keep_one, "one view only (input_Cam000.png)"),
        (another_size, "input_Cam007.png is 30 x 30 RGB uint8"),
        (cut_short, "input_Cam007.png cannot be read"),
        (nan_pixel, "NaN or infinite"),
        (holes, "lacks 3 of the 25 views"),
        (another_truth, "gt_disp_lowres.pfm has 5 x 5 pixels"),
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
        (["--disparity-range=1,1"], "LOW below HIGH"),
        (["--disparity-range=nan,1"], "finite"),
        (["--disparity-range=-inf,1"], "finite"),
        (["--disparity-range=near,far"], "LOW,HIGH such as -2,2"),
        (["--disparity-range=1"], "LOW,HIGH such as -2,2"),
        (["--disparity-range=1,2,3"], "LOW,HIGH such as -2,2"),
        (["--preset", "best"], "unknown preset 'best'"),
        (["--set", "local.nothing=1"], "unknown parameter 'local.nothing'"),
        (["--set", "window"], "stage.parameter=value"),
        (["--set", "prior.window=8"], "must be odd"),
        (["--set", "prior.window=many"], "must be a number"),
        (["--preset", "paper", "--set", "propagation.solver=magic"], "cg, lbfgsb"),
        (["--preset", "paper", "--set", "refinement.solver=magic"], "lbfgs, lbfgsb"),
        (["--backend", "abacus"], "unknown backend 'abacus'"),
        (["--device", "tpu"], "no device 'tpu'"),
        (["--views", "circle"], "full, star, cross, row, column"),
        (["--format", "hologram"], "unknown format 'hologram'"),
        (["--reference-view", "9,0"], "no view at row 9, column 0"),
        (["--reference-view", "middle"], "ROW,COL such as 4,4"),
        (["--reference-view", "nan,1"], "finite"),
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


def raising(error: BaseException) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    "where", ["lfgpu.methods.matching.aggregation.SemiGlobal.__call__", "lfgpu.io.write_result", "lfgpu.io.read"]
)
def test_interruption_leaves_nothing(
    where: str, recorded: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, raising(KeyboardInterrupt()))
    refused(lfgpu("depth", recorded, "-o", out, *RANGE), "interrupted; nothing was written", code=130)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "lfgpu: out of memory; use fewer views"),
        (
            RuntimeError("Failed to allocate 123 bytes on device 'cuda:0'"),
            "lfgpu: out of memory on the device; use fewer views",
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


def test_full_disk_leaves_nothing(recorded: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.io.write_result", raising(OSError(errno.ENOSPC, "No space left on device")))
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
