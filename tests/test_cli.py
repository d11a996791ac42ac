"""Commands that succeed write files that can be read back."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import OUTPUTS, RANGE, SMALL, Outcome, boxes, holes, lfgpu, refused, said
from PIL import Image

from lfgpu import get_threads, scenes, set_threads
from lfgpu._backends import BackendInfo
from lfgpu.cli import demo, summary
from lfgpu.data import LightField
from lfgpu.io import load, read, read_map, write_hci, write_pfm
from lfgpu.machine import device_name
from lfgpu.methods import preset
from lfgpu.metrics import evaluate, sparsification


@pytest.fixture(scope="module")
def scene() -> LightField:
    return boxes()


@pytest.fixture(scope="module")
def solved(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """The folder that `depth` wrote, and what it said."""
    folder = tmp_path_factory.mktemp("solved") / "out"
    return folder, lfgpu("depth", recorded, "-o", folder, *RANGE)


# --- depth: what goes well ---


def test_depth_writes_what_reads_back(solved: tuple[Path, Outcome], scene: LightField) -> None:
    folder, outcome = solved
    assert outcome.raised is None
    assert outcome.code == 0
    assert outcome.err == ""
    assert {file.name for file in folder.iterdir()} == OUTPUTS
    result = load(folder / "result.npz")
    assert result.disparity.shape == scene.size
    assert result.disparity_range == (-2, 2)
    assert result.config == preset("surest")
    np.testing.assert_array_equal(read_map(folder / "disparity.pfm"), result.disparity)
    assert result.depth is not None
    np.testing.assert_array_equal(read_map(folder / "depth.pfm"), result.depth)
    for picture in ("disparity.png", "confidence.png"):
        with Image.open(folder / picture) as image:
            assert min(image.size) > 500


def test_depth_says_what_it_did(solved: tuple[Path, Outcome]) -> None:
    said = solved[1].out
    assert re.search(rf"^  \S*lfgpu view \S+ {re.escape(str(solved[0]))}$", said, re.MULTILINE)
    for words in ("25 of 25", "56 x 48 px", "row 2, column 2", "larger is nearer (given range -2.00 to 2.00)"):
        assert words in said
    result = load(solved[0] / "result.npz")
    assert " ".join(result.status.split()) in " ".join(said.split())
    assert all(name in said for name in (*OUTPUTS, *result.stages, *result.timings.keys() - {"total"}))


def row_of(said: str, name: str) -> list[float]:
    """The numbers in the row of that name of a table of scores."""
    row = re.compile(rf" *{name}( +([0-9.]+|nan|%))+ *")
    line = next(line for line in said.splitlines() if row.fullmatch(line))
    return [float(word) for word in line.split()[1:] if word != "%"]


@pytest.mark.parametrize("of", ["depth", "eval", "eval of a light field"])
def test_scores_and_confidence_are_those_of_the_package(of: str, solved: tuple[Path, Outcome], recorded: Path) -> None:
    folder, outcome = solved
    if of != "depth":
        outcome = lfgpu("eval", folder, recorded if "field" in of else recorded / "gt_disp_lowres.pfm")
    assert outcome.code == 0
    truth, result = read_map(recorded / "gt_disp_lowres.pfm"), load(folder / "result.npz")
    for name, values in result.stages.items():
        m = evaluate(values, truth)
        expected = [m.mse_100, m.badpix_07, m.badpix_03, m.badpix_01, m.q25, m.rmse, m.undefined]
        assert row_of(outcome.out, name) == pytest.approx(expected, abs=0.0051)
    assert "border of 15" in outcome.out
    curve = sparsification(result.disparity, result.confidence, truth)
    said = " ".join(outcome.out.split())
    assert f"{curve.bad[10]:.2f} % of the surest half" in said
    assert f"{curve.oracle[10]:.2f} % is possible" in said
    assert f"{curve.ause:.3f} (AUSE" in said


def test_a_map_alone_has_no_confidence_to_look_at(solved: tuple[Path, Outcome], recorded: Path) -> None:
    text = said("eval", solved[0] / "disparity.pfm", recorded)
    assert "AUSE" not in text


def test_depth_with_options(views: Path, out: Path) -> None:
    holes(views)
    text = said(
        "depth", views, "-o", out, "--allow-missing", "--views", "cross", "--reference-view", "2,1", *RANGE,
        "--set", "refinement.max_iterations=1", "--set", "prior.window=5", "--backend", "warp", "--device", "cpu",
        "--format", "hci", "--preset", "paper",
    )  # fmt: skip
    result = load(out / "result.npz")
    assert result.position == (1, 2)
    assert len(result.trace) <= 2
    assert result.config.prior.window == 5
    assert "belongs to the view at row 2, column 2, not to the reference view" in text
    assert "8 of 25" in text  # the cross without one of the holes


def test_quiet_says_nothing(recorded: Path, out: Path) -> None:
    outcome = lfgpu("depth", recorded, "-o", out, "-q", *RANGE, "--preset=fast")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    assert {file.name for file in out.iterdir()} == OUTPUTS


def test_maps_of_all_views_lie_beside_that_of_the_reference(recorded: Path, scene: LightField, out: Path) -> None:
    text = said("depth", recorded, "-o", out, "--all-views", "--preset", "fast", *RANGE)
    assert "disparities.npz" in text
    assert {file.name for file in out.iterdir()} == OUTPUTS | {"disparities.npz"}
    with np.load(out / "disparities.npz") as maps:
        assert maps["disparities"].shape == maps["confidences"].shape == maps["depths"].shape == scene.views.shape[:3]
        assert maps["disparities"].dtype == np.float32
        np.testing.assert_array_equal(maps["positions"], scene.positions)
        assert "larger is nearer" in str(maps["convention"])
        reference = maps["disparities"][scene.reference_index]
    assert np.isfinite(reference).mean() > 0.95
    apart = np.abs(reference - load(out / "result.npz").disparity)
    assert np.nanmean(apart > 0.05) < 0.18


def test_a_map_within_the_border_is_not_scored(tmp_path: Path, out: Path) -> None:
    write_hci(scenes.make("relief", grid=(3, 3), size=(24, 40)), tmp_path / "small")
    text = said("depth", tmp_path / "small", "-o", out, *RANGE, "--preset=fast")
    assert "cannot be scored" in text
    assert {file.name for file in out.iterdir()} == OUTPUTS


def test_without_geometry_there_is_no_depth(views: Path, out: Path) -> None:
    for name in ("parameters.cfg", "gt_disp_lowres.pfm", "gt_depth_lowres.pfm"):
        (views / name).unlink()
    text = said("depth", views, "-o", out, *RANGE, "--preset=fast")
    assert {file.name for file in out.iterdir()} == OUTPUTS - {"depth.pfm"}
    assert "ground truth" not in text


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


# --- scene ---


def test_scene_writes_what_make_makes(tmp_path: Path) -> None:
    said(
        "scene", "planes", "-o", tmp_path / "s", "--seed", 3, "--grid", "3x5", "--size", "24x32",
        "--disparity-range=-1,1", "--noise", 0.01,
    )  # fmt: skip
    expected = scenes.make("planes", seed=3, grid=(3, 5), size=(24, 32), disparity_range=(-1, 1), noise=0.01)
    found = read(tmp_path / "s")
    np.testing.assert_array_equal(found.views, expected.views)
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
        (["boxes", "--grid=2.5x3"], "ROWSxCOLUMNS such as 9x9"),
        (["boxes", "--size=infx8"], "HEIGHTxWIDTH such as 512x512"),
        (["boxes", "--size=-8x8"], "size must be"),
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
    said("depth", recorded, "-o", out, "--threads", 3, *RANGE)
    assert get_threads() == 3
    np.testing.assert_array_equal(read_map(out / "disparity.pfm"), read_map(solved[0] / "disparity.pfm"))


@pytest.mark.parametrize("command", [["depth", "nowhere"], ["demo"]], ids=["depth", "demo"])
def test_no_threads_are_refused(command: list[str], out: Path) -> None:
    refused(lfgpu(*command, "-o", out, "--threads", 0), "--threads must be an integer >= 1, not 0")
    assert not out.parent.exists()


# --- demo and the whole ---


def test_the_program_is_named_as_a_shell_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`make demo` installs into .venv, which is not active: what is to be typed next begins with the program's path."""
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("lfgpu", "python"):
        (programs / name).touch(mode=0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.executable", str(programs / "python"))
    monkeypatch.setenv("PATH", str(tmp_path))
    assert summary.program() == ".venv/bin/lfgpu"
    monkeypatch.setenv("PATH", str(programs))
    assert summary.program() == "lfgpu"


def test_demo(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "GRID", (5, 5))
    monkeypatch.setattr(demo, "SIZE", (40, 48))
    outcome = lfgpu("demo", "-o", out, "--seed", 1)
    assert outcome.code == 0, outcome.err
    assert {entry.name for entry in out.iterdir()} == OUTPUTS | {"overview.png", "light-field"}
    np.testing.assert_array_equal(read(out / "light-field").views, scenes.make("still_life", seed=1, **SMALL).views)
    said = " ".join(outcome.out.split())
    assert f"lfgpu eval {out}-cross {out}/light-field" in said
    assert f"Try next {summary.program()} view {out}/light-field {out}" in said
    assert row_of(outcome.out, "align")
    with Image.open(out / "overview.png") as image:
        assert min(image.size) > 1000
    assert lfgpu("eval", out, out / "light-field").code == 0
