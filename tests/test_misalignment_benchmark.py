"""The benchmark of self-calibration: what it disturbs, what it takes, and how it tells what is left."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import misalignment
from benchmarks.cli import app
from lfgpu import scenes
from lfgpu.calibration import Misalignment, disturb
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.data.lightfield import LightField


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
