"""`python -m benchmarks scaling` and `tiles`: what they count, with the CPU in the place of several GPUs."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from benchmarks import scaling, tiles
from benchmarks.cases import CASES, Case
from benchmarks.errors import BenchmarkError
from benchmarks.options import collected

pytestmark = pytest.mark.thorough


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
