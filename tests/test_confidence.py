"""The confidence and the uncertainty of matching: what lowers them, where they go, and that fitting finds weights."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from benchmarks import confidence as benchmark
from benchmarks.cli import app
from benchmarks.confidence import Sample, Weights
from lfgpu import DepthResult, LightField, scenes
from lfgpu.io.hci import write_hci

RANGE = (-1.6, 1.7)
WEIGHTS = Weights({"once": (0.5, -1.2, 0.8, -0.4, 0.3, 0.2)}, {"once": (-3.0, 0.5, -1.0, 0.3, -0.2, 0.1)})


def estimated(lf: LightField, **options: object) -> DepthResult:
    return lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu", **options)  # type: ignore[arg-type]


def scene(**options: object) -> LightField:
    return scenes.make("boxes", grid=(7, 7), size=(96, 104), **options)  # type: ignore[arg-type]


def test_the_uncertainty_is_a_standard_deviation_in_pixels() -> None:
    result = estimated(scene())
    assert result.uncertainty is not None
    assert result.uncertainty.dtype == np.float32
    assert result.uncertainty.shape == result.disparity.shape
    assert (result.uncertainty > 0).all()
    sure, unsure = result.confidence > 0.95, result.confidence < 0.6
    assert np.median(result.uncertainty[sure]) < np.median(result.uncertainty[unsure])


def test_synthesis_has_none() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(48, 48))
    assert lfgpu.estimate_depth(lf, config="paper", disparity_range=RANGE, device="cpu").uncertainty is None


def test_misregistered_views_lower_the_confidence() -> None:
    lf = scene()
    shaken = lf.views.copy()
    random = np.random.default_rng(0)
    for index in range(len(shaken)):
        if index != lf.reference_index:
            shaken[index] = np.roll(shaken[index], random.integers(-2, 3, 2), (0, 1))
    good, bad = estimated(lf), estimated(replace(lf, views=shaken))
    assert bad.confidence.mean() < good.confidence.mean() - 0.15
    assert bad.uncertainty.mean() > 2 * good.uncertainty.mean()  # type: ignore[union-attr]


@pytest.mark.parametrize("preset", ["fast", "accurate"])
def test_a_plain_surface_far_from_texture_is_not_believed(preset: str) -> None:
    """Nor because no view sees what is behind it: it is not known where it is."""
    lf = scenes.make("relief", grid=(7, 7), size=(96, 104))
    views = lf.views.copy()
    views[:, :, 44:] = 128
    result = lfgpu.estimate_depth(replace(lf, views=views), config=preset, disparity_range=RANGE, device="cpu")  # type: ignore[arg-type]
    plain, textured = np.s_[20:-20, 75:], np.s_[20:-20, :30]
    assert result.confidence[plain].mean() < 0.75 * result.confidence[textured].mean()
    assert result.uncertainty is not None
    assert result.uncertainty[plain].mean() > 5 * result.uncertainty[textured].mean()
    assert result.uncertainty.max() <= (RANGE[1] - RANGE[0]) / np.sqrt(12) + 1e-6


@pytest.mark.parametrize("suffix", ["npz", "exr"])
def test_files_of_maps_keep_it(tmp_path: Path, suffix: str) -> None:
    if suffix == "exr":
        pytest.importorskip("OpenEXR")
    result = estimated(scene())
    result.map.save(tmp_path / f"map.{suffix}")
    loaded = lfgpu.load(tmp_path / f"map.{suffix}")
    np.testing.assert_array_equal(loaded.uncertainty, result.uncertainty)
    np.testing.assert_array_equal(loaded.disparity, result.disparity)


def test_results_keep_it(tmp_path: Path) -> None:
    result = estimated(scene())
    result.save(tmp_path / "result.npz")
    loaded = lfgpu.load(tmp_path / "result.npz")
    assert isinstance(loaded, DepthResult)
    np.testing.assert_array_equal(loaded.uncertainty, result.uncertainty)


def test_tiles_have_the_same() -> None:
    lf = scenes.make("boxes", grid=(5, 5), size=(150, 220))
    whole, tiled = estimated(lf), estimated(lf, max_memory="1GiB")
    np.testing.assert_allclose(tiled.uncertainty, whole.uncertainty, rtol=0.01)


# --- fitting ---


def made_up(weights: Weights, count: int, seed: int = 0) -> Sample:
    """Pixels whose errors are what the weights say."""
    random = np.random.default_rng(seed)
    features = {name: random.normal(0, 1, count) for name in ("conflict", "evidence", "bend", "relief", "wide", "cost")}
    sample = Sample("made up", "fast", "once", features, np.zeros(count), 2.0)
    said = sample.judged(weights)
    right = random.random(count) < said.confidence
    return replace(sample, error=np.where(right, 0.0, 1.0 + said.deviation * np.abs(random.normal(0, 1, count))))


def test_fitting_finds_the_weights_that_made_the_data() -> None:
    found = benchmark.fit([made_up(WEIGHTS, 200_000)])
    np.testing.assert_allclose(found.share["once"], WEIGHTS.share["once"], atol=0.1)
    assert found.share["again"] == benchmark.NOW.share["again"]


def test_a_calibrated_confidence_is_right_as_often_as_it_says() -> None:
    sample = made_up(WEIGHTS, 100_000)
    whole, alone = benchmark.rows([sample.judged(WEIGHTS)])
    assert (whole.scene, alone.scene, alone.preset) == ("all", "made up", "fast")
    assert whole.bins == alone.bins
    assert sum(one.share for one in alone.bins) == pytest.approx(1)
    assert len(alone.bins) > 4
    for one in alone.bins:
        assert abs(one.said - one.right) < 0.02
    for table in benchmark.tables([whole, alone]):
        assert [row[0] for row in table.rows] == ["all", "made up, fast"]
        assert {len(row) for row in table.rows} == {len(table.columns)}


def test_no_scene_judges_itself() -> None:
    """What is odd about one scene does not help its own confidence, and scenes of the package are not judged."""
    odd = replace(made_up(Weights({"once": (-2.0, 0, 0, 0, 0, 0)}, WEIGHTS.spread), 20_000), scene="odd")
    usual = [replace(made_up(WEIGHTS, 20_000, seed), scene=f"usual {seed}") for seed in (1, 2)]
    own = replace(made_up(WEIGHTS, 20_000, 3), scene="own", own=True)
    judged = benchmark.by_the_others([odd, *usual, own])
    assert [one.sample.scene for one in judged] == ["odd", "usual 1", "usual 2"]
    want = odd.judged(benchmark.fit([*usual, own]))
    np.testing.assert_array_equal(judged[0].confidence, want.confidence)
    np.testing.assert_array_equal(judged[0].deviation, want.deviation)
    assert np.abs(judged[0].confidence - odd.judged(benchmark.fit([odd, *usual, own])).confidence).max() > 0.05


def test_errors_are_counted_in_stated_deviations() -> None:
    sample = made_up(WEIGHTS, 1000)
    deviation = sample.judged(WEIGHTS).deviation
    error = deviation * np.repeat([0.5, -1.5, 2.5, 3.0], 250)
    row = benchmark.rows([replace(sample, error=error).judged(WEIGHTS)])[1]
    assert (row.within_1, row.within_2) == (0.25, 0.5)
    assert row.said_rms == pytest.approx(np.sqrt(np.mean(deviation**2)))
    assert row.error_rms == pytest.approx(np.sqrt(np.mean(error**2)))


def test_the_command_line(tmp_path: Path) -> None:
    write_hci(scenes.make("planes", grid=(5, 5), size=(64, 72)), tmp_path / "one")
    diagram, out = tmp_path / "diagram.png", tmp_path / "confidence.json"
    arguments = ["confidence", str(tmp_path), "--presets", "fast", "--diagram", str(diagram), "-o", str(out)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "one, fast" in done.output
    assert diagram.stat().st_size > 0
    found = json.loads(out.read_text())
    assert not found["fitted"]
    assert found["versions"]["lfgpu"] == lfgpu.__version__
    assert [(row["scene"], row["preset"]) for row in found["rows"]] == [("all", "all"), ("one", "fast")]
    assert all(0 <= one["right"] <= 1 for row in found["rows"] for one in row["bins"])
