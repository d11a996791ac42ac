"""The ablation: that each variant is the method without one thing, that errors are those of its maps, what it says."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import ablation, results, runs
from benchmarks.ablation import SCENES, VARIANTS, Scene, Variant
from benchmarks.cli import app
from benchmarks.clock import spread
from benchmarks.results import Record, Run
from benchmarks.runs import WHOLE, tables
from benchmarks.tables import NONE
from lfgpu import GroundTruth, estimate_depth, evaluate, scenes
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


def test_variants_differ_from_accurate_and_from_each_other() -> None:
    configs = [variant.config() for variant in VARIANTS]
    assert configs[0] == PRESETS["accurate"]
    assert len(set(configs)) == len({variant.name for variant in VARIANTS}) == len(VARIANTS)


@pytest.mark.parametrize("noise", [1e-6, 1.0])
def test_variants_stay_within_the_ranges_whatever_the_noise(noise: float) -> None:
    """What is 0.004 noise's is multiplied by the same factor in each of them: no range cuts it off."""
    whole = PRESETS["accurate"]
    assert isinstance(whole, MatchingConfig)
    factor = in_units_of(noise, whole).tuning.alignment.robust / whole.tuning.alignment.robust
    assert factor != 1
    for variant in VARIANTS:
        before = variant.config()
        if not isinstance(before, MatchingConfig) or before.sweep.noise:
            continue
        after = in_units_of(noise, before)
        for name, power in SCALED.items():
            values = [dict(_values(config))[name] for config in (before, after)]
            assert values[1] == pytest.approx(factor**power * values[0]), (
                f"{variant.name}: {name} is cut off by its range"
            )


def test_every_parameter_that_goes_with_the_noise_is_looked_at() -> None:
    before, after = (dict(_values(config)) for config in (PRESETS[WHOLE], in_units_of(1.0, PRESETS[WHOLE])))
    assert {name for name in before if before[name] != after[name]} == {*SCALED, "sweep.noise"}


def _values(config: MatchingConfig) -> Iterator[tuple[str, Any]]:
    for whole in (config, config.tuning):
        for stage, values in asdict(whole).items():
            if isinstance(values, dict) and stage != "tuning":
                yield from ((f"{stage}.{name}", value) for name, value in values.items())


def test_what_is_not_robust_is_as_stiff_as_what_is() -> None:
    configs = next(v for v in VARIANTS if "alignment.robust" in v.values).config(), PRESETS[WHOLE]
    tunings = [config.tuning for config in configs]
    assert tunings[0].alignment.robust == 100 * tunings[1].alignment.robust
    for stage in ("alignment", "hole_filling"):
        loose, whole = (getattr(tuning, stage).stiffness * tuning.alignment.robust**2 for tuning in tunings)
        assert loose == pytest.approx(whole)


# --- a run ---


def test_errors_are_those_of_the_maps_and_means_over_seeds() -> None:
    run = run_of(SCENES[0], seeds=2)
    assert [record.name for record in run.records] == [variant.name for variant in FEW]
    for record, variant in zip(run.records, FEW, strict=True):
        found = []
        for seed in range(2):
            lf = scenes.make("boxes", seed=seed, grid=(9, 9), size=(SIZE, SIZE))
            assert lf.truth is not None
            true = lf.truth.disparity
            bounds = float(true.min()) - 0.1, float(true.max()) + 0.1
            map_ = estimate_depth(lf, config=variant.config(), disparity_range=bounds).disparity
            found.append(evaluate(map_, true).mse_100)
        assert found[0] != found[1]
        assert record.errors["mse_100"] == pytest.approx(np.mean(found))
        assert [each["mse_100"] for each in record.details["each"]] == pytest.approx(found)
        assert record.case == "boxes 81x48x48, seeds 0 to 1"
        assert record.seconds is not None
        assert record.seconds.n == 2


def test_a_real_scene_is_scored_in_its_mask(tmp_path: Path) -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(SIZE, SIZE))
    assert lf.truth is not None
    mask = np.zeros((SIZE, SIZE), bool)
    mask[:20, 20:] = True
    write_hci(replace(lf, truth=GroundTruth(lf.truth.disparity, lf.truth.position, mask)), tmp_path / "real")
    (record,) = run_of(Scene("real", judging=True), data=tmp_path, variants=FEW[:1]).records
    assert record.compared == f"truth of the data set, {5 * 13} pixels"  # rows 15 to 19, columns 20 to 32
    assert record.details["judging"]
    assert record.details["config"]["sweep"]["resweeps"] == 3


def test_what_fails_is_listed_and_the_rest_goes_on(tmp_path: Path) -> None:
    run = run_of(Scene("nosuch"), Scene("small", "relief"), data=tmp_path)
    missing, *found = run.records
    assert "nosuch is not there" in missing.failed
    assert [bool(record.failed) for record in found] == [False, False]
    assert "not measured" not in runs.markdown(replace(run, records=found)).lower()
    assert "nosuch is not there" in runs.markdown(run)


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


def test_a_few_pixels_are_no_ratio() -> None:
    rows = summary(record_of("a", "accurate", 1.0, 0.0), record_of("a", "other", 1.0, 0.09))
    assert rows["other"][1] == "1.00"


def test_a_scene_without_the_whole_method_counts_for_nothing() -> None:
    assert summary(record_of("a", "other", 2.0), record_of("b", "accurate", 2.0)).keys() == {"accurate"}


def test_the_judging_scene_is_named_as_such() -> None:
    titles = [table.title for table in tables([record_of("a", "accurate", 1.0, judging=True)])]
    assert "no parameter was chosen by it" in titles[1]


# --- the command ---


def told(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, ["ablation", *map(str, arguments)])
    assert done.exit_code == 1
    return done.output


def test_wrong_wishes_are_refused(tmp_path: Path) -> None:
    assert "there are boxes, planes" in told("--scenes", "nosuch")
    assert "nothing could be measured" in told("--scenes", "cotton", "--data", tmp_path)
    assert "nothing could be measured" not in told("--scenes", "cotton", "--data", tmp_path, "--out", tmp_path)


# --- the results ---


def test_the_results_have_every_variant() -> None:
    run: Run = results.load(ROOT / "benchmarks" / "results" / "ablation.json")
    assert {record.name for record in run.records} == {variant.name for variant in VARIANTS}
