"""Benchmarks of streams, devices, rendering, the paper and cameras: what they measure and what they say."""

import json
import mmap
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import flicker, gpu_parity, like, misalignment, moving, population, rendering, scaling, soak, tiles
from benchmarks.cases import CASES, Case
from benchmarks.cli import app
from benchmarks.clock import spread
from benchmarks.errors import BenchmarkError
from benchmarks.options import collected
from benchmarks.results import Record, Run
from lfgpu import scenes
from lfgpu.calibration import Misalignment, disturb
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.data import LightField
from lfgpu.io import write_hci
from lfgpu.pipelines.stream import DepthStream

pytestmark = pytest.mark.thorough

FILM = moving.Film((3, 3), (64, 72), 4, period=40)
SOAK = 2000
"""Frames: some seconds where there is nothing else to do, as most are dropped."""


def measured(out: Path, *arguments: str) -> Any:
    """What a command of the benchmarks writes into a file."""
    outcome = CliRunner().invoke(app, [*arguments, "-o", str(out)])
    assert outcome.exit_code == 0, outcome.output
    return json.loads(out.read_text())


@pytest.fixture(scope="module")
def truth() -> list[np.ndarray]:
    options = FILM.options
    return [
        scenes.true_disparity("moving", 1, 1, time=index / FILM.period, **options).astype(np.float32)
        for index in range(FILM.count)
    ]


def test_truth_does_not_flicker_along_the_true_motion(truth: list[np.ndarray]) -> None:
    """But for what interpolation between pixels of curved surfaces makes of it."""
    motions = list(FILM.motions())
    assert len(motions) == FILM.count - 1
    for index, motion in enumerate(motions):
        change = motion.flicker(truth[index], truth[index + 1])
        still = motion.still()
        assert 0.05 < still.mean() < 0.95
        assert change[still].max() < 1e-6
        assert np.median(change[~still]) < 2e-3
        assert change.mean() < 3e-3
        assert np.abs(truth[index + 1] - truth[index])[motion.counts][~still].mean() > 5 * change[~still].mean()


def test_motion_in_other_views() -> None:
    """What comes nearer moves sideways there, too."""
    (dx, _, dd), owner = scenes.true_motion(1, 2, (0.0, 0.1), **FILM.options)
    (there, _, _), middle = scenes.true_motion(1, 1, (0.0, 0.1), **FILM.options)
    things = np.intersect1d(owner, middle)
    assert len(things) > 2
    for thing in things:
        here, other = owner == thing, middle == thing
        np.testing.assert_allclose(dx[here], there[other][0] - dd[here], atol=1e-9)


def test_flicker_command_finds_that_the_past_helps(tmp_path: Path) -> None:
    out = tmp_path / "flicker.json"
    arguments = ["flicker", "--case=3x3x64x64", "--frames=8", "--seeds=0", "--presets=fast", "--device=cpu"]
    outcome = CliRunner().invoke(app, [*arguments, "-o", str(out)])
    assert outcome.exit_code == 0, outcome.output
    rows = {row["past"]: row for row in json.loads(out.read_text())["rows"]}
    assert list(rows) == list(flicker.PASTS)
    assert rows["whole"]["flicker_median"] < 0.7 * rows["none"]["flicker_median"]
    assert "geometric means over films" in outcome.stdout


def test_live_command(tmp_path: Path) -> None:
    arguments = ["live", "--cases=3x3x48x48", "--presets=fast", "--frames=2", "--seconds=0.2", "--device=cpu"]
    rows = measured(tmp_path / "live.json", *arguments)["rows"]
    assert [row["warm"] for row in rows] == [True, False]
    for row in rows:
        assert 0 < row["latency_p50"] <= row["latency_p95"] <= row["latency_p99"]
        assert row["rate"] > 0
        assert np.isfinite(row["mse_ratio"])


def test_the_span_of_a_case_is_that_of_its_scenes(tmp_path: Path) -> None:
    truth = population.made("boxes-3x3x48x48@8")().reference_truth()
    assert truth is not None
    assert 7 < np.ptp(truth.disparity) <= 8
    for command in ("live", "flicker"):
        option = "--cases" if command == "live" else "--case"
        outcome = CliRunner().invoke(app, [command, f"{option}=3x3x48x48@8", "--device=cpu"])
        assert outcome.exit_code == 1
        assert "leave it out" in outcome.output


def test_parity_takes_all_files_of_kernels_that_ask_for_a_device() -> None:
    asking = re.compile(r"^def test_.*\b(target|other):", re.MULTILINE | re.DOTALL)
    folder = Path(__file__).with_name("kernels")
    wanted = {f"tests/kernels/{path.name}" for path in folder.glob("test_*.py") if asking.search(path.read_text())}
    assert wanted - {"tests/kernels/test_native_code.py"} <= set(gpu_parity.FILES)
    assert wanted


# --- the soak ---


def plan(frames: int) -> soak.Plan:
    return soak.Plan(frames, (3, 3), (24, 24), "fast", 0, "cpu", burst=12)


def soaked(frames: int) -> soak.Found:
    *_, found = soak.run(plan(frames))
    return found


def test_soak() -> None:
    found = soaked(SOAK)
    assert found.problems == []
    stats = found.stats
    assert stats["frames_pushed"] == SOAK + 2
    assert stats["frames_pushed"] == stats["frames_done"] + stats["frames_dropped"] + stats["frames_failed"]
    for name in ("frames_done", "frames_failed", "scene_cuts", "frames_with_missing_views"):
        assert stats[name] > SOAK / 500


def test_soak_notices_a_lost_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DepthStream, "_fail", lambda self, result, error: result._fail(error))
    assert any("counts are wrong" in problem for problem in soaked(40).problems)


def test_soak_notices_frames_that_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, outcome = [], soak._outcome

    def keeping(*arguments: Any) -> list[str]:
        frame = mmap.mmap(-1, 9 * 24 * 24 * 3, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)  # not in what others freed
        frame.write(bytes(len(frame)))
        kept.append(frame)
        return outcome(*arguments)

    monkeypatch.setattr(soak, "_outcome", keeping)
    assert any("memory of the host grew" in problem for problem in soaked(800).problems)


def test_soak_notices_memory_that_grows() -> None:
    steady = soak.Found({}, host_bytes=[50 << 20, *[100 << 20] * 19])
    late = soak.Found({}, host_bytes=[*[100 << 20] * 15, *[130 << 20] * 5])  # something is used for the first time
    growing = soak.Found({}, host_bytes=[(400 + 3 * look) << 18 for look in range(20)])
    for found, problems in ((steady, 0), (late, 0), (growing, 1)):
        soak._judge(found)
        assert len(found.problems) == problems


def test_what_is_measured_before_an_estimate_is_timed(tmp_path: Path) -> None:
    options = ["--cases=3x3x48x48", "--preset=fast", "--seconds=0.05", "--device=cpu"]
    (row,) = measured(tmp_path / "range.json", "range", *options)["rows"]
    assert (row["backend"], row["device"]) == ("warp", "cpu")
    assert min(row["range_ms"], row["resident_ms"], row["noise_ms"], row["first_ms"]) > 0
    assert 2 <= row["waits"] <= 7
    assert row["found"][0] < row["true"][0] < row["true"][1] < row["found"][1]


@pytest.mark.parametrize(("kind", "counts"), [("processes", (2,)), ("threads", (1, 2))])
def test_every_mode_and_count_is_measured(kind: str, counts: tuple[int, ...], tmp_path: Path) -> None:
    plan = scaling.Plan(CASES[:1], ("fast",), ("cpu", "cpu"), counts, kind, 0.1)
    rows = collected(scaling.run(plan), tmp_path / "scaling.json", benchmark="scaling")
    assert [(row["mode"], row["devices"]) for row in rows] == [(m, n) for m in scaling.MODES for n in counts]
    for row in rows:
        assert row["rate"] > 0
        assert row["milliseconds"] > 0
        assert row["efficiency"] == 1 or row["devices"] > 1
    assert len(json.loads((tmp_path / "scaling.json").read_text())["rows"]) == len(rows)


def test_tiles_are_measured_within_each_limit() -> None:
    case = Case((3, 3), (128, 144))
    rows = list(tiles.measure(case, "fast", "cpu", [None, "2GiB"]))
    assert [row["max_memory"] for row in rows] == [None, "2GiB"]
    assert str(rows[1]["status"]).startswith("In one piece: ")
    for row in rows:
        assert row["seconds"] > row["timings"]["sweep"] > 0
        assert row["device"] == "cpu"
        assert row["host_bytes"] is None or row["host_bytes"] > 50 * 2**20


def test_rendered_views_win_on_a_scene_and_the_table_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_hci(scenes.make("relief", grid=(5, 5), size=(48, 48)), tmp_path / "relief")
    rows = list(rendering.run(["relief", "nothing"], tmp_path, preset="fast", every=6))
    assert "nothing is not there, left out" in capsys.readouterr().err
    (row,) = rows
    assert (row["scene"], row["kept"], row["rendered"]) == ("relief", 9, 3)
    for values in (row["whole"], row["inner"]):
        assert values["rendered"] > values["mean of neighbours"] > values["nearest view"]
    assert f"**{row['whole']['rendered']:.1f} / {row['inner']['rendered']:.1f}**" in rendering.table(rows).markdown
    with pytest.raises(BenchmarkError, match="LFGPU_DATA"):
        list(rendering.run(["nothing"], tmp_path, preset="fast", every=1))


@pytest.fixture(scope="module")
def planes() -> LightField:
    return scenes.make("planes", grid=(9, 9), size=(96, 104), seed=1)


@pytest.mark.parametrize(
    ("array", "count", "reach"),
    [("9x9", 81, 4), ("5x5", 25, 2), ("3x5", 15, 2), ("star", 33, 4), ("row", 9, 4), ("irregular", 12, 4)],
)
def test_arrays_are_parts_of_the_grid(planes: LightField, array: str, count: int, reach: float) -> None:
    indices: list[int] = []
    found = misalignment._chosen(planes, array, indices)
    assert len(found.views) == count == len(indices)
    assert np.abs(found.offsets).max() == reach
    assert found.reference_truth() is not None
    np.testing.assert_array_equal(found.positions, planes.positions[indices])
    assert misalignment._chosen(planes.subset("cross"), "5x5") is None


def test_what_is_left_is_measured_against_the_cameras(planes: LightField) -> None:
    lf = planes.subset("star")
    cameras = disturb(lf, Misalignment(shift=1.0), seed=2).cameras
    off = misalignment._left(lf, list(cameras), None, None)
    assert off is not None
    assert off == pytest.approx(1.0, abs=0.2)
    # The homographies that undo it exactly: a turn about the centre is one.
    found = []
    for ideal, real in zip(ideal_cameras(lf), cameras, strict=True):
        found.append(real.matrix @ np.asarray(real.rotation) @ np.linalg.inv(ideal.matrix))
    assert misalignment._left(lf, list(cameras), np.array(found), None) == pytest.approx(0, abs=1e-6)
    assert misalignment._left(lf, list(cameras), None, np.ones((33, 2))) is None  # parallax, not shifts


def test_the_command_writes_what_it_found(planes: LightField, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(misalignment, "recording", lambda _: lambda moved: planes)
    options = ["--arrays=3x3", "--misalign=shift=1", "--crop=88", "--preset=fast", "--device=cpu"]
    (row,) = measured(tmp_path / "found.json", "misalignment", "planes", *options)["rows"]
    assert (row["array"], row["views"], row["disturbance"]) == ("3x3", 9, "shift=1")
    assert row["left_px"] < 0.1 < row["off_px"]
    assert row["refined"]["level_03"] < row["wrong"]["level_03"]


def test_rows_are_read_back_and_the_level_is_what_shifts_raise(planes: LightField, tmp_path: Path) -> None:
    offsets = planes.offsets
    cameras = ideal_cameras(planes)
    plain = np.tile(np.eye(3), (len(cameras), 1, 1))
    plain[:, :2, 2] = 0.1 * offsets  # pixels are looked up where disparities that are higher by 0.1 put them
    found = misalignment._shifts(planes, list(cameras), plain)
    assert (found * offsets).sum() / (offsets**2).sum() == pytest.approx(0.1, abs=1e-6)
    assert misalignment._level(planes, list(cameras)) == pytest.approx(0, abs=1e-6)
    (tmp_path / "a.json").write_text('{"rows": [{}]}')
    with pytest.raises(BenchmarkError, match="no rows"):
        misalignment.load(tmp_path / "a.json")


def test_the_judge_on_the_command_line(tmp_path: Path) -> None:
    found = measured(tmp_path / "found.json", "judge", "boxes-3", "--draws=1", "--crop=96", "--device=cpu")
    assert found["plan"]["scenes"] == ["boxes-3"]
    (draw,) = found["draws"]
    assert (draw["views"], np.hypot(*draw["moved"])) == (81, pytest.approx(0.2))
    assert found["summary"]["found"] == 1
    assert found["summary"]["false_alarms"] == 0
    assert np.hypot(*np.subtract(draw["found"], draw["moved"])) < 0.05


# --- like, windows ---


@pytest.mark.parametrize("command", ["like", "windows"])
def test_sides_that_the_network_does_not_take_are_refused(command: str, tmp_path: Path) -> None:
    outcome = CliRunner().invoke(app, [command, "--side", "100", "-o", str(tmp_path / "out.npz")])
    assert outcome.exit_code == 2
    assert "it must be a multiple of 32, not 100." in outcome.output


def test_gain_is_fitted_over_shipped_for_each_rig() -> None:
    errors = {"shipped": {"row": 2.0, "ring": 3.0}, "fitted": {"row": 1.0, "ring": 6.0}}
    records = [
        Record(
            "accuracy", "warp", "cpu", "boxes", f"{which}, {rig}, {source}, range true", spread([1.0]),
            errors=dict.fromkeys(("mse_100", "badpix_07", "badpix_03", "badpix_01"), error),
            details={"preset": f"{rig}, {source}", "range": "true"},
        )
        for which, rigs in errors.items()
        for rig, error in rigs.items()
        for source in ("package", "generated")
    ]  # fmt: skip
    run = replace(Run.begun("like"), records=records)
    assert [(row[0], row[2]) for row in like.gain(run).rows] == [
        ("row, package", "0.50"), ("row, generated", "0.50"), ("ring, package", "2.00"), ("ring, generated", "2.00"),
    ]  # fmt: skip
    assert [(r.case, r.details["preset"], r.errors["mse_100"]) for r in like.by_weights(run)] == [
        (f"boxes, {rig}", which, error) for which, rigs in errors.items() for rig, error in rigs.items()
    ]


def test_pairs_with_another_program(tmp_path: Path) -> None:
    write_hci(scenes.make("boxes", grid=(3, 3), size=(48, 48)), tmp_path / "boxes")
    other = f"{sys.executable} -c 'sum(range(3_000_000))'"
    content = measured(tmp_path / "out.json", "pairs", str(tmp_path / "boxes"), other, "--presets=fast", "--pairs=3")
    assert content["other"] == other
    assert [row["what"] for row in content["rows"]] == ["command", "estimate"]
    for row in content["rows"]:
        for kind in ("cpu", "wall"):
            assert min(row[f"{kind}_s"], row[f"other_{kind}_s"]) > 0.01
            ratio = row[f"{kind}_s"] / row[f"other_{kind}_s"]
            assert row[f"{kind}_ratio"] == pytest.approx(ratio, rel=0.8), "they are medians of three"
    command, estimate = content["rows"]
    assert command["cpu_s"] > 2 * estimate["cpu_s"], "a process has to begin first"


@pytest.mark.parametrize(
    ("other", "said"), [("no-such-program x", "cannot be started"), ("false", "false failed"), ("", "no command")]
)
def test_pairs_with_a_program_that_does_not_run(tmp_path: Path, other: str, said: str) -> None:
    write_hci(scenes.make("boxes", grid=(3, 3), size=(48, 48)), tmp_path / "boxes")
    outcome = CliRunner().invoke(app, ["pairs", str(tmp_path / "boxes"), other, "--presets=fast"])
    assert outcome.exit_code == 1
    assert said in outcome.output
