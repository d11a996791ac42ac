"""The command line: what goes wrong is one sentence and leaves nothing behind, what goes well can be read back."""

from __future__ import annotations

import errno
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from lfgpu import get_threads, list_backends, scenes, set_threads
from lfgpu._backends import BackendInfo
from lfgpu.cli import app, demo
from lfgpu.config import Config, Section, number, parameters
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import formats, read, read_map, read_result, write_hci, write_pfm
from lfgpu.io.formats import FORMATS, Format
from lfgpu.machine import device_name
from lfgpu.methods import METHODS, PRESETS, preset
from lfgpu.methods.entry import Entry
from lfgpu.metrics import evaluate, sparsification

OUTPUTS = {"confidence.png", "depth.pfm", "disparity.pfm", "disparity.png", "result.npz"}
RANGE = ("--disparity-range", "-2,2")
SMALL = {"grid": (5, 5), "size": (40, 48)}


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str
    raised: BaseException | None


def lfgpu(*arguments: object) -> Outcome:
    """Run a command in this process."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    raised = None if isinstance(result.exception, SystemExit) else result.exception
    return Outcome(result.exit_code, result.stdout, result.stderr, raised)


def refused(outcome: Outcome, words: str, code: int = 1) -> None:
    """Exactly one sentence on stderr, with those words in it, and nothing on stdout."""
    assert outcome.raised is None
    assert outcome.code == code
    assert outcome.out == ""
    assert re.fullmatch(r"lfgpu: [^\n]*\.\n", outcome.err), outcome.err
    assert words in outcome.err


@pytest.fixture(scope="session")
def scene() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(48, 56))


@pytest.fixture(scope="session")
def recorded(scene: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene as an HCI folder; tests that change it take `views`."""
    folder = tmp_path_factory.mktemp("recorded") / "boxes"
    write_hci(scene, folder)
    return folder


@pytest.fixture(scope="session")
def solved(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """The folder that `depth` wrote, and what it said."""
    folder = tmp_path_factory.mktemp("solved") / "out"
    return folder, lfgpu("depth", recorded, "-o", folder, *RANGE)


@pytest.fixture
def views(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the views, to be damaged."""
    return Path(shutil.copytree(recorded, tmp_path / "views"))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A place for outputs whose parent is not there yet."""
    return tmp_path / "deep" / "out"


# --- depth: what goes wrong ---


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


def holes(folder: Path) -> None:
    for index in (0, 7, 13):
        (folder / f"input_Cam{index:03d}.png").unlink()


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
    "where", ["lfgpu.methods.matching.plan.MatchingPlan._find_surface", "lfgpu.io.write_result", "lfgpu.io.read"]
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


# --- depth: what goes well ---


def test_depth_writes_what_reads_back(solved: tuple[Path, Outcome], scene: LightField) -> None:
    folder, outcome = solved
    assert outcome.raised is None
    assert outcome.code == 0
    assert outcome.err == ""
    assert {file.name for file in folder.iterdir()} == OUTPUTS
    result = read_result(folder / "result.npz")
    assert result.disparity.shape == scene.size
    assert result.disparity_range == (-2, 2)
    assert result.config == preset("accurate")
    np.testing.assert_array_equal(read_map(folder / "disparity.pfm"), result.disparity)
    assert result.depth is not None
    np.testing.assert_array_equal(read_map(folder / "depth.pfm"), result.depth)
    for picture in ("disparity.png", "confidence.png"):
        with Image.open(folder / picture) as image:
            assert min(image.size) > 500


def test_depth_says_what_it_did(solved: tuple[Path, Outcome]) -> None:
    said = solved[1].out
    for words in ("25 of 25", "56 x 48 px", "row 2, column 2", "larger is nearer (given range -2.00 to 2.00)"):
        assert words in said
    result = read_result(solved[0] / "result.npz")
    assert " ".join(result.status.split()) in " ".join(said.split())
    assert all(name in said for name in (*OUTPUTS, *result.stages, *result.timings.keys() - {"total"}))


def row_of(said: str, name: str) -> list[float]:
    """The numbers in the row of that name of a table of scores."""
    row = re.compile(rf" *{name}( +([0-9.]+|nan|%))+ *")
    line = next(line for line in said.splitlines() if row.fullmatch(line))
    return [float(word) for word in line.split()[1:] if word != "%"]


@pytest.mark.parametrize("of", ["depth", "eval", "eval of a light field"])
def test_scores_are_those_of_evaluate(of: str, solved: tuple[Path, Outcome], recorded: Path) -> None:
    folder, outcome = solved
    if of != "depth":
        outcome = lfgpu("eval", folder, recorded if "field" in of else recorded / "gt_disp_lowres.pfm")
    assert outcome.code == 0
    truth = read_map(recorded / "gt_disp_lowres.pfm")
    for name, values in read_result(folder / "result.npz").stages.items():
        m = evaluate(values, truth)
        expected = [m.mse_100, m.badpix_07, m.badpix_03, m.badpix_01, m.q25, m.rmse, m.undefined]
        assert row_of(outcome.out, name) == pytest.approx(expected, abs=0.0051)
    assert "border of 15" in outcome.out


@pytest.mark.parametrize("of", ["depth", "eval", "eval of a light field"])
def test_what_the_confidence_tells_is_that_of_sparsification(
    of: str, solved: tuple[Path, Outcome], recorded: Path
) -> None:
    folder, outcome = solved
    if of != "depth":
        outcome = lfgpu("eval", folder, recorded if "field" in of else recorded / "gt_disp_lowres.pfm")
    result = read_result(folder / "result.npz")
    curve = sparsification(result.disparity, result.confidence, read_map(recorded / "gt_disp_lowres.pfm"))
    for name, shares in (("confidence", curve.bad), ("oracle", curve.oracle)):
        expected = [shares[list(np.round(curve.kept)).index(kept)] for kept in (100, 95, 90, 75, 50, 25)]
        assert row_of(outcome.out, name) == pytest.approx(expected, abs=0.0051)
    assert f"{curve.ause:.3f} (AUSE" in " ".join(outcome.out.split())


def test_a_map_alone_has_no_confidence_to_look_at(solved: tuple[Path, Outcome], recorded: Path) -> None:
    outcome = lfgpu("eval", solved[0] / "disparity.pfm", recorded)
    assert outcome.code == 0
    assert "AUSE" not in outcome.out


def test_depth_with_options(views: Path, out: Path) -> None:
    holes(views)
    outcome = lfgpu(
        "depth", views, "-o", out, "--allow-missing", "--views", "cross", "--reference-view", "2,1", *RANGE,
        "--set", "refinement.max_iterations=1", "--set", "prior.window=5", "--backend", "warp", "--device", "cpu",
        "--format", "hci", "--preset", "paper",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    result = read_result(out / "result.npz")
    assert result.position == (1, 2)
    assert len(result.trace) <= 2
    assert result.config.prior.window == 5
    assert "belongs to the view at row 2, column 2, not to the reference view" in outcome.out
    assert "8 of 25" in outcome.out  # the cross without one of the holes


def test_quiet_says_nothing(recorded: Path, out: Path) -> None:
    outcome = lfgpu("depth", recorded, "-o", out, "-q", *RANGE, "--set=alignment.iterations=1")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    assert {file.name for file in out.iterdir()} == OUTPUTS


def test_maps_of_all_views_lie_beside_that_of_the_reference(recorded: Path, scene: LightField, out: Path) -> None:
    outcome = lfgpu("depth", recorded, "-o", out, "--all-views", "--preset", "fast", *RANGE)
    assert outcome.code == 0, outcome.err
    assert "disparities.npz" in outcome.out
    assert {file.name for file in out.iterdir()} == OUTPUTS | {"disparities.npz"}
    with np.load(out / "disparities.npz") as maps:
        assert maps["disparities"].shape == maps["confidences"].shape == maps["depths"].shape == scene.views.shape[:3]
        assert maps["disparities"].dtype == np.float32
        np.testing.assert_array_equal(maps["positions"], scene.positions)
        assert "larger is nearer" in str(maps["convention"])
        reference = maps["disparities"][scene.reference_index]
    assert np.isfinite(reference).mean() > 0.95
    assert np.nanmedian(np.abs(reference - read_result(out / "result.npz").disparity)) < 0.05


def test_a_map_within_the_border_is_not_scored(tmp_path: Path, out: Path) -> None:
    write_hci(scenes.make("relief", grid=(3, 3), size=(24, 40)), tmp_path / "small")
    outcome = lfgpu("depth", tmp_path / "small", "-o", out, *RANGE)
    assert outcome.code == 0, outcome.err
    assert "cannot be scored" in outcome.out
    assert {file.name for file in out.iterdir()} == OUTPUTS


def test_without_geometry_there_is_no_depth(views: Path, out: Path) -> None:
    for name in ("parameters.cfg", "gt_disp_lowres.pfm", "gt_depth_lowres.pfm"):
        (views / name).unlink()
    outcome = lfgpu("depth", views, "-o", out, *RANGE, "--set=alignment.iterations=1")
    assert outcome.code == 0, outcome.err
    assert {file.name for file in out.iterdir()} == OUTPUTS - {"depth.pfm"}
    assert "ground truth" not in outcome.out


# --- info ---


def test_info(recorded: Path) -> None:
    outcome = lfgpu("info", recorded)
    assert outcome.code == 0
    said = " ".join(outcome.out.split())
    for words in (
        "hci, because it is a folder with input_Cam000.png",
        "25 of 25 in a 5 x 5 grid",
        "56 x 48 px (width x height), colour, uint8",
        "row 2, column 2",
        "-2 to 2 view steps across (du), -2 to 2 down (dv)",
        "focal length 160 px",
        "100.0 % of it scored",
    ):
        assert words in said


def test_info_reports_missing_views(views: Path) -> None:
    holes(views)
    outcome = lfgpu("info", views, "--format", "hci")
    assert outcome.code == 0
    said = " ".join(outcome.out.split())
    assert "22 of 25" in said
    assert "3: row 0, column 0; row 1, column 2; row 2, column 3 (counted from 0)" in said
    assert "hci, as told" in said


def test_info_of_what_is_no_light_field(tmp_path: Path) -> None:
    refused(lfgpu("info", tmp_path / "nowhere"), "does not exist")
    refused(lfgpu("info", tmp_path), "an empty folder")


# --- scene ---


def test_scene_writes_what_make_makes(tmp_path: Path) -> None:
    outcome = lfgpu(
        "scene", "planes", "-o", tmp_path / "s", "--seed", 3, "--grid", "3x5", "--size", "24x32",
        "--disparity-range=-1,1", "--noise", 0.01,
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    expected = scenes.make("planes", seed=3, grid=(3, 5), size=(24, 32), disparity_range=(-1, 1), noise=0.01)
    found = read(tmp_path / "s")
    np.testing.assert_array_equal(found.views, expected.views)
    assert found.truth is not None
    assert expected.truth is not None
    np.testing.assert_array_equal(found.truth.disparity, expected.truth.disparity)


def test_frames_of_a_scene_that_moves(tmp_path: Path) -> None:
    arguments = ("scene", "moving", "-o", tmp_path / "s", "--grid=3x3", "--size=24x24", "--frames", 2)
    assert lfgpu(*arguments).code == 0
    assert sorted(folder.name for folder in (tmp_path / "s").iterdir()) == ["frame_000", "frame_001"]
    assert (read(tmp_path / "s" / "frame_000").views != read(tmp_path / "s" / "frame_001").views).any()
    refused(lfgpu(*arguments), "already holds frames of a sequence")


def test_interrupted_frames_leave_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Path] = []

    def second_fails(light_field: LightField, folder: Path) -> None:
        if written:
            raise KeyboardInterrupt
        write_hci(light_field, folder)
        written.append(folder)

    monkeypatch.setattr("lfgpu.io.write_hci", second_fails)
    outcome = lfgpu("scene", "moving", "-o", tmp_path / "s", "--grid=3x3", "--size=24x24", "--frames=2")
    refused(outcome, "interrupted", code=130)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["castle"], ", ".join(scenes.NAMES)),
        (["boxes", "--frames=2"], "needs a scene that moves"),
        (["moving", "--frames=0"], "frames"),
        (["boxes", "--grid=3"], "ROWSxCOLUMNS such as 9x9"),
        (["boxes", "--grid=1x1"], "at least two views"),
        (["boxes", "--grid=2.5x3"], "ROWSxCOLUMNS such as 9x9"),
        (["boxes", "--size=infx8"], "HEIGHTxWIDTH such as 512x512"),
        (["boxes", "--size=-8x8"], "size must be"),
        (["boxes", "--noise=nan"], "noise must be"),
        (["boxes", "--seed=-1"], "seed must be"),
        (["boxes", "--disparity-range=1,0"], "LOW below HIGH"),
    ],
)
def test_wrong_scenes(arguments: list[str], words: str, out: Path) -> None:
    refused(lfgpu("scene", *arguments, "-o", out), words)
    assert not out.parent.exists()


# --- eval ---


def test_eval_of_maps_with_mask_and_border(tmp_path: Path, rng: np.random.Generator) -> None:
    truth, mask = rng.random((40, 50)), rng.random((40, 50)) < 0.5
    estimate = truth + rng.normal(0, 0.05, truth.shape)
    np.save(tmp_path / "e.npy", estimate)
    write_pfm(tmp_path / "t.pfm", truth)
    Image.fromarray(mask.astype(np.uint8) * 255).save(tmp_path / "m.png")
    outcome = lfgpu("eval", tmp_path / "e.npy", tmp_path / "t.pfm", "--mask", tmp_path / "m.png", "--border", 3)
    m = evaluate(estimate, truth.astype(np.float32), mask=mask, border=3)
    assert row_of(outcome.out, "e.npy")[:2] == pytest.approx([m.mse_100, m.badpix_07], abs=0.0051)
    assert f"Over {m.count} pixels, without a border of 3 px." in outcome.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.pfm", "views"], "nowhere.pfm does not exist"),
        (["out", "nowhere"], "nowhere does not exist"),
        (["views", "views"], "neither result.npz nor disparity.pfm"),
        (["out", "views", "--border", "40"], "border must be"),
        (["out", "views", "--mask", "no.png"], "no.png cannot be read"),
        (["out", "other"], "but the result belongs to the view at row 2, column 2; give a result of that view"),
        (["out", "bare"], "holds no ground truth"),
        (["out/disparity.pfm", "small.npy"], "same shape"),
        (["out/disparity.png", "views"], "not a kind of map"),
    ],
)
def test_eval_refuses(
    arguments: list[str], words: str, solved: tuple[Path, Outcome], views: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("out").symlink_to(solved[0])
    write_hci(scenes.make("relief", grid=(3, 3), size=(48, 56)), "other")
    shutil.copytree(views, "bare")
    Path("bare/gt_disp_lowres.pfm").unlink()
    np.save("small.npy", np.zeros((20, 20)))
    refused(lfgpu("eval", *arguments), words)


# --- backends ---


def test_backends_shows_what_is_here_and_how_to_get_what_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    described = (
        BackendInfo("warp", "warp-lang", "1.19.0", ("cuda:0", "cpu")),
        BackendInfo("taichi", "taichi", None, (), "cannot be loaded: No module named 'taichi'", "pip install taichi"),
        BackendInfo("fpga", "fpga-tools", "2.0", (), "cannot be loaded: OSError: libfpga.so: [no such file]", None),
    )
    monkeypatch.setattr("lfgpu._backends.describe_backends", lambda: described)
    monkeypatch.setattr("lfgpu.machine.device_name", {"cuda:0": "NVIDIA H200"}.get)
    outcome = lfgpu("backends")
    assert (outcome.code, outcome.err) == (0, "")
    rows = [" ".join(line.split()) for line in outcome.out.splitlines() if line.strip()][2:]
    assert rows == [
        "warp (default) warp-lang 1.19.0 cuda:0: NVIDIA H200",
        "cpu",
        "taichi taichi: not installed cannot be loaded: No module named 'taichi'",
        "pip install taichi",
        "fpga fpga-tools 2.0 cannot be loaded: OSError: libfpga.so: [no such file]",
    ]


def test_backends_has_a_row_for_each_that_there_is() -> None:
    outcome = lfgpu("backends")
    assert outcome.code == 0
    for backend in list_backends():
        assert re.search(rf"^ {backend} ", outcome.out, re.MULTILINE)


def test_devices_without_a_known_name_have_none() -> None:
    assert device_name("tpu:0") is None
    assert device_name("cuda:999") is None
    assert device_name("cpu") != ""


# --- threads ---


@pytest.fixture
def _threads_as_before() -> Iterator[None]:
    yield
    set_threads(None)


@pytest.mark.usefixtures("_threads_as_before")
def test_threads_are_used_and_change_nothing(solved: tuple[Path, Outcome], recorded: Path, out: Path) -> None:
    outcome = lfgpu("depth", recorded, "-o", out, "--threads", 3, *RANGE)
    assert outcome.code == 0, outcome.err
    assert get_threads() == 3
    np.testing.assert_array_equal(read_map(out / "disparity.pfm"), read_map(solved[0] / "disparity.pfm"))


@pytest.mark.parametrize("command", [["depth", "nowhere"], ["demo"]], ids=["depth", "demo"])
def test_no_threads_are_refused(command: list[str], out: Path) -> None:
    refused(lfgpu(*command, "-o", out, "--threads", 0), "--threads must be an integer >= 1, not 0")
    assert not out.parent.exists()


# --- demo and the whole ---


def test_demo(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "GRID", (5, 5))
    monkeypatch.setattr(demo, "SIZE", (40, 48))
    outcome = lfgpu("demo", "-o", out, "--seed", 1)
    assert outcome.code == 0, outcome.err
    assert {entry.name for entry in out.iterdir()} == OUTPUTS | {"overview.png", "sparsification.png", "light-field"}
    np.testing.assert_array_equal(read(out / "light-field").views, scenes.make("boxes", seed=1, **SMALL).views)
    said = " ".join(outcome.out.split())
    assert f"lfgpu eval {out}-cross {out}/light-field" in said
    assert row_of(outcome.out, "align")
    with Image.open(out / "overview.png") as image:
        assert min(image.size) > 1000
    assert lfgpu("eval", out, out / "light-field").code == 0


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
    refused(lfgpu("parameters", "--preset", "fats"), "unknown preset 'fats'; use one of accurate, fast, paper")
