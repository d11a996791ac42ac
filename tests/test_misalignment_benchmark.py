"""The benchmark of self-calibration: what it disturbs, what it takes, and how it tells what is left."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import judge, misalignment
from benchmarks.cli import app
from benchmarks.errors import BenchmarkError
from lfgpu import scenes
from lfgpu.calibration import Misalignment, disturb
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.data.lightfield import LightField

pytestmark = pytest.mark.thorough


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
    assert found is not None
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
