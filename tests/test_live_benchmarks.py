"""Benchmarks of streams: motion is true, flicker is found, and a soak would notice faults."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import flicker, gpu_parity, moving, soak
from benchmarks.cli import app
from lfgpu import scenes
from lfgpu.pipelines.intake import Intake
from lfgpu.pipelines.stream import DepthStream

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
    assert wanted - {"tests/kernels/test_warp_threads.py"} <= set(gpu_parity.FILES)
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
