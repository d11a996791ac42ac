"""The ablation and the accuracy of a population: scores are those of the maps, and what they are held against."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import ablation, drawn, population, results, runs, scoring
from benchmarks.ablation import SCENES, VARIANTS, Scene, Variant
from benchmarks.cli import app
from benchmarks.clock import spread
from benchmarks.errors import BenchmarkError
from benchmarks.results import Record, Run
from benchmarks.runs import WHOLE, tables
from benchmarks.tables import NONE
from lfgpu import GroundTruth, estimate_depth, evaluate, read, scenes
from lfgpu.comparison import Scene as Compared
from lfgpu.io import write_hci
from lfgpu.methods import PRESETS
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.noise import in_units_of

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[1]
SIZE = 48
SCALED = {
    **dict.fromkeys(("alignment.robust", "alignment.contrast", "boundaries.contrast"), 1.0),
    **dict.fromkeys(("semi_global.small_penalty", "semi_global.large_penalty", "prior.sigma_color"), 0.5),
}
"""The parameters that grow with the noise, and with which power of it."""
FEW = (VARIANTS[0], next(v for v in VARIANTS if v.values.get("sweep.views") == "cross"))


def run_of(*chosen: Scene, data: Path = ROOT, seeds: int = 1, variants: tuple[Variant, ...] = FEW) -> Run:
    return ablation.run(chosen, variants, size=SIZE, seeds=seeds, data=data)


def record_of(case: str, name: str, mse: float, badpix: float = 1.0, *, judging: bool = False) -> Record:
    errors = {"mse_100": mse, "badpix_07": badpix, "badpix_03": 5.0, "badpix_01": 9.0, "q25": 0.1}
    return Record("ablation", "warp", "cpu", case, name, spread([1.0]), errors=errors, details={"judging": judging})


def summary(*records: Record) -> dict[str, tuple[str, ...]]:
    return {row[0]: row[1:] for row in tables(records)[0].rows}


# --- what is left out ---


def test_variants_differ_and_all_have_results() -> None:
    configs = [variant.config() for variant in VARIANTS]
    assert configs[0] == PRESETS["accurate"]
    assert len(set(configs)) == len({variant.name for variant in VARIANTS}) == len(VARIANTS)
    run: Run = results.load(ROOT / "benchmarks" / "results" / "ablation.json")
    assert {record.name for record in run.records} == {variant.name for variant in VARIANTS}
    before, after = (dict(_values(config)) for config in (PRESETS[WHOLE], in_units_of(1.0, PRESETS[WHOLE])))
    assert {name for name in before if before[name] != after[name]} == {*SCALED, "sweep.noise"}


def _values(config: MatchingConfig) -> Iterator[tuple[str, Any]]:
    for whole in (config, config.tuning):
        for stage, values in asdict(whole).items():
            if isinstance(values, dict) and stage != "tuning":
                yield from ((f"{stage}.{name}", value) for name, value in values.items())


# --- a run ---


def test_errors_are_those_of_the_maps_and_means_over_seeds() -> None:
    run = run_of(SCENES[0], seeds=2)
    assert [record.name for record in run.records] == [variant.name for variant in FEW]
    for record, variant in zip(run.records, FEW, strict=True):
        found = []
        for seed in range(2):
            lf = scenes.make("boxes", seed=seed, grid=(9, 9), size=(SIZE, SIZE))
            true = lf.truth.disparity
            bounds = float(true.min()) - 0.1, float(true.max()) + 0.1
            map_ = estimate_depth(lf, config=variant.config(), disparity_range=bounds).disparity
            found.append(evaluate(map_, true).mse_100)
        assert found[0] != found[1]
        assert record.errors["mse_100"] == pytest.approx(np.mean(found))
        assert [each["mse_100"] for each in record.details["each"]] == pytest.approx(found)
        assert record.case == "boxes 81x48x48, seeds 0 to 1"
        assert record.seconds.n == 2


def test_a_real_scene_is_scored_in_its_mask(tmp_path: Path) -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(SIZE, SIZE))
    mask = np.zeros((SIZE, SIZE), bool)
    mask[:20, 20:] = True
    write_hci(replace(lf, truth=GroundTruth(lf.truth.disparity, lf.truth.position, mask)), tmp_path / "real")
    (record,) = run_of(Scene("real", judging=True), data=tmp_path, variants=FEW[:1]).records
    assert record.compared == f"truth of the data set, {5 * 13} pixels"  # rows 15 to 19, columns 20 to 32
    assert record.details["judging"]
    assert record.details["config"]["sweep"]["resweeps"] == 3


def test_a_run_comes_back_from_its_file(tmp_path: Path) -> None:
    run = run_of(SCENES[0], variants=FEW[:1])
    results.save(run, tmp_path / "run.json")
    assert results.load(tmp_path / "run.json") == run
    assert run.commit is None


# --- what it says ---


def test_ratios_are_geometric_means_and_judging_stands_apart() -> None:
    rows = summary(
        *(record_of("a", "accurate", 1.0), record_of("a", "other", 2.0, 3.0)),
        *(record_of("b", "accurate", 2.0), record_of("b", "other", 1.0, 12.0)),
        *(record_of("c", "accurate", 1.0, judging=True), record_of("c", "other", 8.0, judging=True)),
        *(record_of("d", "accurate", 1.0), record_of("d", "rare", 5.0)),
    )
    assert rows["accurate"] == ("1.00", "1.00", "1.00", "0 / 0 of 3", "1.00", "1.00", "1.00")
    assert rows["other"] == ("1.00", "6.00", "1.00", "1 / 1 of 2", "8.00", "1.00", "1.00")
    assert rows["rare"] == ("5.00", "1.00", "1.00", "1 / 0 of 1", NONE, NONE, NONE)


# --- the results ---


FAST = {"fast": PRESETS["fast"]}


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


def run_with(*records: Record) -> Run:
    return Run("2026-01-01T00:00:00+00:00", {}, {}, None, 1, None, list(records), [])


def accuracy(*arguments: str | Path) -> Any:
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
    done = accuracy("--drawn", "1", "--first", "12", "--presets", "fast", "-o", small)
    assert done.exit_code == 0, done.output
    assert {(r.case, r.name) for r in results.load(small).records} == {
        (name, "fast, range found"),
        (name, "fast, range true"),
    }


def test_scores_are_those_of_the_map_with_the_range_that_is_said(folder: Path) -> None:
    pictures: list[Compared] = []
    found = population.run({"first": lambda: read(folder / "first")}, FAST, ["true"], pictures.append)
    (scored,) = found.records
    lf = read(folder / "first")
    truth = lf.reference_truth()
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


def test_ratios_are_geometric_means_and_the_worst_is_named() -> None:
    old = run_with(record("a", "found", 4.0), record("b", "found", 4.0), record("gone", "found", 1.0))
    new = run_with(record("a", "found", 1.0), record("b", "found", 8.0), record("new", "found", 9.0))
    (row,) = runs.against(new, old).rows
    assert row[:5] == ("fast, range found", "2", "1.00", "0.71", "1.00")
    assert row[6] == "b 2.00"


def test_the_command_line(folder: Path, tmp_path: Path) -> None:
    out, sheet = tmp_path / "run.json", tmp_path / "sheet.png"
    options = ("--presets", "fast", "--ranges", "true")
    done = accuracy("--population", folder / "first", folder / "second", *options, "-o", out, "--sheet", sheet)
    assert done.exit_code == 0, done.output
    assert [r.case for r in results.load(out).records] == ["first", "second"]
    assert sheet.stat().st_size > 0
    again = accuracy(folder, *options, "--baseline", out)
    assert "ratios to the baseline" in again.output
    assert "unknown range 'guessed'" in accuracy(folder, "--ranges", "guessed").output
    assert "no light fields to score" in accuracy().output
    assert "unknown preset" in accuracy(folder, "--presets", "nosuch").output
