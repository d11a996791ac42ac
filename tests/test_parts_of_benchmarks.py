"""Benchmarks of streams, devices, rendering, the paper and cameras: what they measure and what they say."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from typer.testing import CliRunner

from benchmarks import (
    flicker,
    gpu_parity,
    judge,
    like,
    misalignment,
    moving,
    paper,
    rendering,
    results,
    scaling,
    soak,
    tiles,
)
from benchmarks.cases import CASES, Case
from benchmarks.cli import app
from benchmarks.clock import spread
from benchmarks.errors import BenchmarkError
from benchmarks.options import collected
from benchmarks.results import Record, Run
from lfgpu import estimate_depth, evaluate, scenes
from lfgpu.calibration import Misalignment, disturb
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.data.lightfield import LightField
from lfgpu.io import write_hci
from lfgpu.pipelines.intake import Intake
from lfgpu.pipelines.stream import DepthStream
from tests import printed
from tests.io.fields import SAMPLES, scene

pytestmark = pytest.mark.thorough

FILM = moving.Film((3, 3), (64, 72), 4, period=40)
SOAK = 2000
"""Frames: some seconds where there is nothing else to do, as most are dropped."""


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


def test_flicker_of_maps_that_do(truth: list[np.ndarray]) -> None:
    motion = next(FILM.motions())
    change = motion.flicker(truth[0], truth[1] + np.float32(0.25))
    assert np.median(change) == pytest.approx(0.25, abs=1e-3)


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


def test_flicker_command_with_a_past_that_is_none() -> None:
    outcome = CliRunner().invoke(app, ["flicker", "--pasts=some"])
    assert outcome.exit_code == 1
    assert "costs only" in outcome.stderr


def test_live_command(tmp_path: Path) -> None:
    out = tmp_path / "live.json"
    arguments = ["live", "--cases=3x3x48x48", "--presets=fast", "--frames=2", "--seconds=0.2", "--device=cpu"]
    outcome = CliRunner().invoke(app, [*arguments, "-o", str(out)])
    assert outcome.exit_code == 0, outcome.output
    rows = json.loads(out.read_text())["rows"]
    assert [row["warm"] for row in rows] == [True, False]
    for row in rows:
        assert 0 < row["latency_p50"] <= row["latency_p95"] <= row["latency_p99"]
        assert row["rate"] > 0
        assert np.isfinite(row["mse_ratio"])


def test_cases_that_are_none() -> None:
    outcome = CliRunner().invoke(app, ["live", "--cases=7x7x375"])
    assert outcome.exit_code == 1
    assert "ROWSxCOLUMNSxHEIGHTxWIDTH" in outcome.stderr


def test_parity_is_written_file_by_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a run that is ended keeps what it has."""
    options = '    parser.addoption("--backend"), parser.addoption("--device")'
    (tmp_path / "conftest.py").write_text(f"def pytest_addoption(parser):\n{options}\n")
    (tmp_path / "test_one.py").write_text('def test_it(record_property):\n    record_property("splat", 0.25)\n')
    monkeypatch.setattr(gpu_parity, "ROOT", tmp_path)
    monkeypatch.setattr(gpu_parity, "FILES", ("test_one.py", "not_there.py"))
    out = tmp_path / "parity.json"
    outcome = CliRunner().invoke(app, ["gpu-parity", "--device=cpu", "-o", str(out)])
    assert outcome.exit_code == 1
    assert "not_there" in outcome.stderr
    found = json.loads(out.read_text())
    assert (found["files"], found["left"]) == (["test_one.py"], ["not_there.py"])
    assert (found["passed"], found["failed"], found["errors"]) == (1, [], {"splat": 0.25})


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


def test_soak_of_raw_pictures(tmp_path: Path) -> None:
    out = tmp_path / "soak.json"
    arguments = ["soak", "--frames=30", "--case=3x3x48x48", "--preset=fast", "--rectify", "--device=cpu"]
    outcome = CliRunner().invoke(app, [*arguments, "-o", str(out)])
    assert outcome.exit_code == 0, outcome.output
    found = json.loads(out.read_text())
    assert found["plan"]["rectified"]
    assert found["problems"] == []
    assert found["stats"]["frames_pushed"] == 32


def test_soak_that_is_ended_leaves_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = iter([None, None])
    monkeypatch.setattr(soak, "_look", lambda found: next(looks))
    out = tmp_path / "soak.json"
    options = ["--frames=20", "--case=3x3x24x24", "--preset=fast", "--device=cpu", f"--out={out}"]
    CliRunner().invoke(app, ["soak", *options])
    assert json.loads(out.read_text())["stats"]["frames_pushed"] == 3


def test_soak_notices_a_lost_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DepthStream, "_fail", lambda self, result, error: result._fail(error))
    assert any("counts are wrong" in problem for problem in soaked(40).problems)


def test_soak_notices_a_bad_frame_that_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Intake, "checked_valid", lambda self, valid: np.ones(9, bool))
    monkeypatch.setattr(soak, "_BAD", 0.5)
    one_by_one = replace(plan(40), burst=1)  # none is dropped
    *_, found = soak.run(one_by_one)
    assert any("was taken" in problem for problem in found.problems)


def test_soak_notices_memory_that_grows() -> None:
    steady = soak.Found({}, host_bytes=[50 << 20, *[100 << 20] * 19])
    growing = soak.Found({}, host_bytes=[(100 + 3 * look) << 20 for look in range(20)])
    for found, problems in ((steady, 0), (growing, 1)):
        soak._judge(found)
        assert len(found.problems) == problems


def test_soak_notices_another_map_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """As there is if it still starts from the last one."""
    monkeypatch.setattr(DepthStream, "restart", lambda self: None)
    monkeypatch.setattr(soak, "_CUT", 0.0)
    assert any("another map" in problem for problem in soaked(40).problems)


def test_what_rectification_adds_is_measured(tmp_path: Path) -> None:
    out = tmp_path / "rectify.json"
    options = ["--cases=3x3x48x48", "--preset=fast", "--seconds=0.05", "--device=cpu", "--out", str(out)]
    outcome = CliRunner().invoke(app, ["rectify", *options])
    assert outcome.exit_code == 0, outcome.output
    found = json.loads(out.read_text())
    (row,) = found["rows"]
    assert (row["views"], row["backend"], row["device"]) == (9, "warp", "cpu")
    assert row["error"] < 0.51  # whole numbers are stored
    assert min(row["all_ms"], row["used_ms"], row["frame_ms"], row["rectified_ms"], row["host_ms"]) > 0
    assert row["added_ms"] == pytest.approx(row["rectified_ms"] - row["frame_ms"])


def test_what_is_measured_before_an_estimate_is_timed(tmp_path: Path) -> None:
    out = tmp_path / "range.json"
    options = ["--cases=3x3x48x48", "--preset=fast", "--seconds=0.05", "--device=cpu", "--out", str(out)]
    outcome = CliRunner().invoke(app, ["range", *options])
    assert outcome.exit_code == 0, outcome.output
    (row,) = json.loads(out.read_text())["rows"]
    assert (row["backend"], row["device"]) == ("warp", "cpu")
    assert min(row["range_ms"], row["resident_ms"], row["noise_ms"], row["first_ms"]) > 0
    assert 2 <= row["waits"] <= 7
    assert row["found"][0] < row["true"][0] < row["true"][1] < row["found"][1]


@pytest.mark.parametrize(("kind", "counts"), [("processes", (2,)), ("threads", (1, 2))])
def test_every_mode_and_count_is_measured(kind: str, counts: tuple[int, ...], tmp_path: Path) -> None:
    plan = scaling.Plan(CASES[:1], ("fast",), ("cpu", "cpu"), counts, kind, 0.1)
    rows = collected(scaling.run(plan), tmp_path / "scaling.json", benchmark="scaling")
    assert [(row.mode, row.devices) for row in rows] == [(m, n) for m in scaling.MODES for n in counts]
    for row in rows:
        assert row.rate > 0
        assert row.milliseconds > 0
        assert row.efficiency == 1 or row.devices > 1
    assert len(json.loads((tmp_path / "scaling.json").read_text())["rows"]) == len(rows)


def test_more_devices_than_there_are_is_an_error() -> None:
    with pytest.raises(BenchmarkError, match="there are 1 devices, not 4"):
        next(scaling.run(scaling.Plan(CASES[:1], ("fast",), ("cpu",), (1, 4))))


def test_tiles_are_measured_within_each_limit() -> None:
    case = Case((3, 3), (128, 144))
    rows = list(tiles.measure(case, "fast", "cpu", [None, "2GiB"]))
    assert [row["max_memory"] for row in rows] == [None, "2GiB"]
    assert str(rows[1]["status"]).startswith("In one piece: ")
    for row in rows:
        assert row["seconds"] > row["timings"]["sweep"] > 0
        assert row["device"] == "cpu"
        assert row["host_bytes"] is None or row["host_bytes"] > 50 * 2**20


def test_the_painted_scene_is_what_its_truth_says(tmp_path: Path) -> None:
    """Whatever all views show of a plane is where its disparity puts it."""
    truth = tiles.paint(Case((3, 3), (96, 120)), tmp_path / "views.npy")
    views = np.load(tmp_path / "views.npy").astype(np.float64)
    y, x = np.mgrid[8:88, 8:112]
    for row, column in np.ndindex(3, 3):
        places = y - truth[8:88, 8:112] * (row - 1), x - truth[8:88, 8:112] * (column - 1)
        found = map_coordinates(views[row, column, ..., 0], places, order=1)
        assert np.median(np.abs(found - views[1, 1, 8:88, 8:112, 0])) < 4  # of 255, what interpolating twice costs
    assert np.abs(views[0, 0] - views[1, 1]).mean() > 10


def test_every_second_row_and_column_is_left_out() -> None:
    lf = scenes.make("relief", grid=(5, 5), size=(32, 32))
    kept, left_out = rendering.split(lf)
    assert kept.positions.tolist() == [[u, v] for v in (0, 2, 4) for u in (0, 2, 4)]
    assert sorted([*left_out, *(int(v) * 5 + int(u) for u, v in kept.positions)]) == list(range(25))


def test_psnr_by_hand() -> None:
    assert rendering.psnr(np.full((2, 2), 0.6, np.float32), np.full((2, 2), 0.5, np.float32)) == pytest.approx(20)


def test_rendered_views_win_on_a_scene_and_the_table_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_hci(scenes.make("relief", grid=(5, 5), size=(48, 48)), tmp_path / "relief")
    rows = list(rendering.run(["relief", "nothing"], tmp_path, preset="fast", every=6))
    assert "nothing is not there, left out" in capsys.readouterr().err
    (row,) = rows
    assert (row.scene, row.kept, row.rendered) == ("relief", 9, 3)
    for values in (row.whole, row.inner):
        assert values["rendered"] > values["mean of neighbours"] > values["nearest view"]
    assert f"**{row.whole['rendered']:.1f} / {row.inner['rendered']:.1f}**" in rendering.table(rows).markdown
    with pytest.raises(BenchmarkError, match="LFGPU_DATA"):
        list(rendering.run(["nothing"], tmp_path, preset="fast", every=1))


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one scene of the old HCI set; the equations are not what is tested."""
    monkeypatch.setattr(printed, "errors", lambda *_: {"an equation": 1e-7})
    folder = tmp_path / "data" / "buddha"
    folder.mkdir(parents=True)
    SAMPLES["hci-hdf5"].write(scene(), folder)
    return folder.parent


def test_a_scene_that_is_there_is_measured_and_the_others_are_skipped_with_a_word(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    arguments = ["--data", str(data), "--out", str(tmp_path / "paper.json"), "--presets", "fast"]
    names = "buddha-9x9x768x768,horses-9x9x768x768"
    outcome = CliRunner().invoke(app, ["paper", "--experiments", names, *arguments])
    assert outcome.exit_code == 0, outcome.output
    assert f"horses-9x9x768x768: skipped: {data / 'horses'} does not exist" in outcome.stderr.replace("\n", "")
    found = [r for r in results.load(tmp_path / "paper.json").records if r.kind == paper.KIND]
    assert [(r.case, r.name, r.failed) for r in found] == [("buddha-9x9x768x768", "fast", "")]
    lf = scene()
    want = evaluate(estimate_depth(lf, config="fast").disparity, lf.truth.disparity).rmse
    assert found[0].errors["rmse boundaries"] == pytest.approx(want, rel=1e-3)
    assert "mean of" not in outcome.stdout


def test_the_mean_of_the_old_hci_set_is_that_of_last_stages() -> None:
    records = [
        Record(paper.KIND, "warp", "cpu", e.name, "paper", spread([1.0]), errors={"rmse local": 9, "rmse refine": n})
        for n, e in enumerate(e for e in paper.EXPERIMENTS if e.name.endswith("-9x9x768x768"))
    ]
    run = Run("", {}, {}, "", 1, 0.0, records, [])
    assert paper.experiments(run).rows[-1] == ("mean of the old HCI set", "`paper`", "–", "–", "3.000", "–")
    assert "mean" not in paper.experiments(Run("", {}, {}, "", 1, 0.0, records[1:], [])).rows[-1][0]


def test_specks_are_counted() -> None:
    plane = np.add.outer(np.arange(20.0), np.arange(25.0)) / 100
    assert paper.speckle(plane) == 0
    plane[10, 10] += 0.2
    plane[3, 3] = np.nan
    assert paper.speckle(plane) == pytest.approx(100 / 499)


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
    outcome = CliRunner().invoke(app, ["misalignment", "planes", *options, "-o", str(tmp_path / "found.json")])
    assert outcome.exit_code == 0, outcome.output
    (row,) = json.loads((tmp_path / "found.json").read_text())["rows"]
    assert (row["array"], row["views"], row["disturbance"]) == ("3x3", 9, "shift=1")
    assert row["left_px"] < 0.1 < row["off_px"]
    assert row["refined"]["level_03"] < row["wrong"]["level_03"]


def test_wrong_wishes_are_refused() -> None:
    outcome = CliRunner().invoke(app, ["misalignment", "planes", "--arrays=circle"])
    assert outcome.exit_code == 1
    assert "unknown array 'circle'" in outcome.output
    outcome = CliRunner().invoke(app, ["misalignment", "planes", "--misalign=bend=1"])
    assert outcome.exit_code == 1
    assert "misalignment must be" in outcome.output


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


def test_a_view_counts_as_found_if_it_alone_is_named() -> None:
    one = "the view at row 3, column 4 is 0.19 px to the right of and 0.06 px below where it should be: line it up."
    assert judge.names((one,), (3, 4))
    assert not judge.names((one,), (4, 3))
    assert not judge.names((), (3, 4))
    assert not judge.names((one, "the views differ in brightness by 4 % (rms)."), (3, 4))
    two = "the view at row 3, column 4 is 0.2 px to the left of where it should be; " + one
    assert not judge.names((two,), (3, 4))


def test_the_judge_on_the_command_line(tmp_path: Path) -> None:
    options = ["--draws=1", "--crop=96", "--device=cpu", "-o", str(tmp_path / "found.json")]
    outcome = CliRunner().invoke(app, ["judge", "boxes-3", *options])
    assert outcome.exit_code == 0, outcome.output
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["plan"]["scenes"] == ["boxes-3"]
    (draw,) = found["draws"]
    assert (draw["views"], np.hypot(*draw["moved"])) == (81, pytest.approx(0.2))
    assert found["summary"]["found"] == 1
    assert found["summary"]["false_alarms"] == 0
    assert np.hypot(*np.subtract(draw["found"], draw["moved"])) < 0.05


# --- like ---


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
