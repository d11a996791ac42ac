"""The accuracy of a population: that scores are those of the maps, against which range, and what it is held against."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import drawn, population, results, runs, scoring
from benchmarks.cli import app
from benchmarks.clock import spread
from benchmarks.errors import BenchmarkError
from benchmarks.results import Record, Run
from lfgpu import estimate_depth, evaluate, read, scenes
from lfgpu.comparison import Scene
from lfgpu.io.hci import write_hci
from lfgpu.methods import PRESETS

FAST = {"fast": PRESETS["fast"]}

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small light fields in a folder, and something else."""
    root = tmp_path_factory.mktemp("population")
    for seed, name in enumerate(("first", "second")):
        write_hci(scenes.make("planes", seed=seed, grid=(5, 5), size=(64, 72)), root / name)
    (root / "notes").mkdir()
    return root


def record(case: str, given: str, badpix: float, preset: str = "fast") -> Record:
    errors = {"mse_100": 1.0, "badpix_07": badpix, "badpix_03": 2.0, "badpix_01": 3.0, "q25": 1.0, "ause": 0.3}
    return Record(
        population.KIND,
        "warp",
        "cpu",
        case,
        f"{preset}, range {given}",
        spread([1.0]),
        errors={**errors, "span": 1.0},
        details={"preset": preset, "range": given},
    )


def run_of(*records: Record) -> Run:
    return Run("2026-01-01T00:00:00+00:00", {}, {}, None, 1, None, list(records), [])


def told(*arguments: str | Path) -> Any:
    return CliRunner().invoke(app, ["accuracy", *map(str, arguments)])


def test_light_fields_that_are_drawn_stand_beside_folders(tmp_path: Path) -> None:
    """Each seed is a light field of its own, and always the same."""
    several, again = drawn.drawn(3, 40), drawn.drawn(12, 1)
    assert len(several) == 40
    assert list(again) == [list(several)[9]]
    (name,) = again
    one, other = several[name](), again[name]()
    assert np.array_equal(one.views, other.views)
    assert one.truth is not None
    assert name.startswith("12-")
    assert f"{one.size[0]}x{one.size[1]}" in name
    assert len({name.split("-")[1] for name in several}) == 5

    small = tmp_path / "drawn.json"
    done = told("--drawn", "1", "--first", "12", "--presets", "fast", "-o", small)
    assert done.exit_code == 0, done.output
    assert {(r.case, r.name) for r in results.load(small).records} == {
        (name, "fast, range found"),
        (name, "fast, range true"),
    }


def test_scenes_of_the_package_stand_beside_folders() -> None:
    name = "planes-5x5x64x72"
    found = population.run({name: population.made(name)}, FAST, ["true"])
    lf = scenes.make("planes", grid=(5, 5), size=(64, 72))
    assert lf.truth is not None
    (scored,) = found.records
    assert scored.case == "planes-5x5x64x72"
    assert scored.details["true"] == [lf.truth.disparity.min(), lf.truth.disparity.max()]


@pytest.mark.parametrize("name", ["nosuch-5x5x64x72", "planes", "planes-5x5x64"])
def test_scenes_that_there_are_not_are_refused(name: str) -> None:
    done = told("--scenes", name)
    assert done.exit_code == 1
    assert "scene" in done.output or "is no case" in done.output


def test_scores_are_those_of_the_map_with_the_range_that_is_said(folder: Path) -> None:
    pictures: list[Scene] = []
    found = population.run({"first": lambda: read(folder / "first")}, FAST, ["true"], pictures.append)
    (scored,) = found.records
    lf = read(folder / "first")
    truth = lf.reference_truth()
    assert truth is not None
    low, high = float(truth.disparity.min()) - 0.1, float(truth.disparity.max()) + 0.1
    assert scored.details["searched"] == [low, high]
    result = estimate_depth(lf, config="fast", disparity_range=(low, high))
    assert scored.errors["badpix_07"] == evaluate(result.disparity, truth.disparity).badpix_07
    assert scored.errors["span"] == pytest.approx((high - low) / (high - low - 0.2))
    (picture,) = pictures
    error = (picture.maps["fast, range true"] - picture.truth)[15:-15, 15:-15]
    np.testing.assert_array_equal(error, (result.disparity - truth.disparity)[15:-15, 15:-15])


def test_a_folder_is_a_light_field_or_holds_some(folder: Path, tmp_path: Path) -> None:
    assert list(scoring.light_fields([folder])) == ["first", "second"]
    assert scoring.light_fields([folder / "second"]) == {"second": folder / "second"}
    with pytest.raises(BenchmarkError, match="holds no light field"):
        scoring.light_fields([tmp_path])
    with pytest.raises(BenchmarkError, match="is no folder"):
        scoring.light_fields([tmp_path / "nosuch"])


def test_what_fails_is_a_record_that_says_why(folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "gt_disp_lowres.pfm").write_bytes((folder / "first" / "gt_disp_lowres.pfm").read_bytes())
    (scored,) = population.run({"broken": lambda: read(broken)}, FAST, ["true"]).records
    assert "broken" in scored.failed


def test_ratios_are_geometric_means_and_the_worst_is_named() -> None:
    old = run_of(record("a", "found", 4.0), record("b", "found", 4.0), record("gone", "found", 1.0))
    new = run_of(record("a", "found", 1.0), record("b", "found", 8.0), record("new", "found", 9.0))
    (row,) = runs.against(new, old).rows
    assert row[:5] == ("fast, range found", "2", "1.00", "0.71", "1.00")
    assert row[6] == "b 2.00"


def test_a_failed_scene_is_in_no_mean() -> None:
    failed = replace(record("a", "found", 4.0), seconds=None, errors={}, failed="no")
    assert runs.against(run_of(failed), run_of(record("a", "found", 4.0))).rows == []


def test_the_found_range_is_held_against_the_true_one() -> None:
    *_, compared = runs.tables([record("a", "found", 6.0), record("a", "true", 4.0)])
    (row,) = compared.rows
    assert (row[0], row[3]) == ("fast, range found", "1.50")


def test_the_command_line(folder: Path, tmp_path: Path) -> None:
    out, sheet = tmp_path / "run.json", tmp_path / "sheet.png"
    options = ("--presets", "fast", "--ranges", "true")
    done = told("--population", folder / "first", folder / "second", *options, "-o", out, "--sheet", sheet)
    assert done.exit_code == 0, done.output
    assert [r.case for r in results.load(out).records] == ["first", "second"]
    assert sheet.stat().st_size > 0
    again = told(folder, *options, "--baseline", out)
    assert "ratios to the baseline" in again.output
    assert "unknown range 'guessed'" in told(folder, "--ranges", "guessed").output
    assert "no light fields to score" in told().output
    assert "unknown preset" in told(folder, "--presets", "nosuch").output
