"""The confidence of matching, reasons to doubt a pixel, and what is unknown, which is NaN everywhere."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import said
from typer.testing import CliRunner

import lfgpu
from benchmarks import cli, confidence as benchmark
from benchmarks.confidence import Sample, Weights
from lfgpu import DepthResult, LightField, Reason, estimate_depth, reasons, scenes
from lfgpu.data.filling import filled
from lfgpu.errors import LightFieldError
from lfgpu.io.hci import write_hci
from tests.made import thorough

RANGE = (-1.6, 1.7)
WEIGHTS = Weights({"once": (0.5, -1.2, 0.8, -0.4, 0.3, 0.2)}, {"once": (-3.0, 0.5, -1.0, 0.3, -0.2, 0.1)})


def estimated(lf: LightField, **options: object) -> DepthResult:
    return lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu", **options)  # type: ignore[arg-type]


def scene(**options: object) -> LightField:
    return scenes.make("boxes", grid=(7, 7), size=(96, 104), **options)  # type: ignore[arg-type]


def test_synthesis_has_none_and_matching_a_standard_deviation() -> None:
    result = estimated(scene())
    assert result.uncertainty.dtype == np.float32
    assert result.uncertainty.shape == result.disparity.shape
    assert (result.uncertainty > 0).all()
    sure, unsure = result.confidence > 0.95, result.confidence < 0.6
    assert np.median(result.uncertainty[sure]) < np.median(result.uncertainty[unsure])
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


@pytest.mark.parametrize("preset", ["fast", thorough("accurate")])
def test_a_plain_surface_far_from_texture_is_not_believed(preset: str) -> None:
    """Nor because no view sees what is behind it: it is not known where it is."""
    lf = scenes.make("relief", grid=(7, 7), size=(96, 104))
    views = lf.views.copy()
    views[:, :, 44:] = 128
    result = lfgpu.estimate_depth(replace(lf, views=views), config=preset, disparity_range=RANGE, device="cpu")  # type: ignore[arg-type]
    plain, textured = np.s_[20:-20, 75:], np.s_[20:-20, :30]
    assert result.confidence[plain].mean() < 0.75 * result.confidence[textured].mean()
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
    assert [one.scene for one in judged] == ["odd", "usual 1", "usual 2"]
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
    arguments = ["confidence", str(tmp_path), "--presets", "fast,surest", "--diagram", str(diagram), "-o", str(out)]
    done = CliRunner().invoke(cli.app, arguments)
    assert done.exit_code == 0, done.output
    assert "one, fast" in done.output
    assert diagram.stat().st_size > 0
    found = json.loads(out.read_text())
    assert not found["fitted"]
    assert found["versions"]["lfgpu"] == lfgpu.__version__
    assert [row["scene"] for row in found["rows"]] == ["all", "one", "one"]
    assert [row["preset"] for row in found["rows"]] == ["all", "fast", "surest"]
    assert all(0 <= one["right"] <= 1 for row in found["rows"] for one in row["bins"])


SIZE, BOUNDS = (64, 96), (-1.6, 1.6)


@pytest.fixture(scope="module")
def planes() -> LightField:
    return scenes.make("bars", grid=(5, 5), size=SIZE)


@pytest.fixture(scope="module")
def true(planes: LightField) -> DepthResult:
    """A result whose map is the truth."""
    result = estimate_depth(planes, config="fast", disparity_range=BOUNDS, check_cameras=False)
    return replace(result, disparity=planes.truth.disparity)


def where(reason: Reason, lf: LightField, result: DepthResult) -> np.ndarray:
    return reasons(lf, result) & reason > 0


def test_a_true_map_of_a_textured_scene_is_rarely_doubted(planes: LightField, true: DepthResult) -> None:
    found = reasons(planes, true)
    assert found.dtype == np.uint8
    for reason in Reason:
        share = np.mean(found & reason > 0)
        assert share < 0.15, (reason, share)


def test_plain_surfaces_have_no_texture(planes: LightField, true: DepthResult) -> None:
    """Also along one direction only, where the cameras stand in a row."""
    plain = planes.views.copy()
    plain[:, 20:40, 30:70] = 128
    found = where(Reason.NO_TEXTURE, replace(planes, views=plain), true)
    assert found[25:35, 35:65].all()
    assert found[:14].mean() < 0.2
    stripes = np.broadcast_to(np.where(np.arange(SIZE[0]) % 8 < 4, 60, 190)[None, :, None, None], planes.views.shape)
    striped = replace(planes, views=np.ascontiguousarray(stripes, np.uint8))
    row = striped.subset(np.flatnonzero(striped.offsets[:, 1] == 0))
    column = striped.subset(np.flatnonzero(striped.offsets[:, 0] == 0))
    assert where(Reason.NO_TEXTURE, row, true).all()
    assert not where(Reason.NO_TEXTURE, column, true).any()


def test_hidden_pixels_are_those_beside_a_nearer_surface(planes: LightField, true: DepthResult) -> None:
    disparity = np.full(SIZE, -1, np.float32)
    disparity[:, 40:50] = 1.5
    result = replace(true, disparity=disparity)
    right = planes.subset(np.flatnonzero((planes.offsets[:, 0] >= 0) & (planes.offsets[:, 1] == 0)))
    found = where(Reason.HIDDEN, right, result)[:, 10:-10]
    # The view beside the reference hides two and a half columns, the one behind it five: fewer than half see the first.
    assert found[:, 38 - 10 : 40 - 10].all()
    assert not found[:, : 37 - 10].any()
    assert not found[:, 40 - 10 :].any()
    assert not where(Reason.HIDDEN, right, replace(true, disparity=np.zeros(SIZE, np.float32)))[:, :-10].any()


def test_surfaces_beyond_the_range_are_at_its_end(planes: LightField, true: DepthResult) -> None:
    low = float(np.median(planes.truth.disparity))
    cut = replace(true, disparity=planes.truth.disparity.clip(low), disparity_range=(low, BOUNDS[1]))
    np.testing.assert_array_equal(where(Reason.END_OF_RANGE, planes, cut)[planes.truth.disparity <= low], True)
    assert not where(Reason.END_OF_RANGE, planes, true).any()


def test_what_views_do_not_show_is_unexplained(planes: LightField, true: DepthResult) -> None:
    """A glint that only the reference shows."""
    glint = planes.views.copy()
    glint[planes.reference_index, 20:30, 40:50] = 255
    found = where(Reason.UNEXPLAINED, replace(planes, views=glint), true)
    assert found[21:29, 41:49].mean() > 0.8
    assert found[40:].mean() < 0.1


def test_masked_pixels_have_no_reason_and_bad_cameras_are_one_everywhere(planes: LightField, true: DepthResult) -> None:
    disparity = true.disparity.copy()
    disparity[:10] = np.nan
    found = reasons(planes, replace(true, disparity=disparity, remarks=("views are shifted.",)))
    assert not found[:10].any()
    assert (found[10:] & Reason.CAMERAS > 0).all()


HOLE = np.s_[:10, -16:]


def masked(size: tuple[int, int] = (40, 48)) -> LightField:
    """A scene of which no view recorded one corner."""
    lf = scenes.make("relief", grid=(5, 5), size=size)
    valid = np.ones(lf.views.shape[:3], bool)
    valid[(slice(None), *HOLE)] = False
    return replace(lf, valid=valid)


def hole(lf: LightField) -> np.ndarray:
    return ~lf.valid[lf.reference_index]


@pytest.mark.parametrize("config", ["accurate", "fast", thorough("paper")])
def test_masked_pixels_of_the_reference_are_nan_in_all_maps(config: str, target: Any) -> None:
    lf = masked()
    result = lfgpu.estimate_depth(
        lf, config=config, disparity_range=RANGE, backend=target.backend, device=target.device
    )
    np.testing.assert_array_equal(np.isnan(result.disparity), hole(lf))
    assert (result.confidence[hole(lf)] == 0).all()
    assert (result.confidence[~hole(lf)] > 0).any()
    for name, map_ in result.stages.items():
        assert np.isnan(map_[hole(lf)]).all(), name


def test_they_leave_the_rest_as_it_is(target: Any) -> None:
    lf = masked()
    pipeline = lfgpu.DepthPipeline(
        lf, config="fast", disparity_range=RANGE, backend=target.backend, device=target.device
    )
    maps = []
    for _ in range(3):  # the next run does not start from what the last one left
        pipeline.run()
        maps.append(pipeline.disparity())
    np.testing.assert_array_equal(maps[0], maps[2])
    whole = lfgpu.estimate_depth(replace(lf, valid=None), config="fast", disparity_range=RANGE, device="cpu")
    assert np.nanquantile(np.abs(maps[0] - whole.disparity), 0.95) < 0.01


def test_maps_of_all_views_are_nan_where_no_key_view_shows_the_pixel() -> None:
    lf = masked()
    result = lfgpu.estimate_all_views(lf, keys=1, config="fast", disparity_range=RANGE)
    known = np.isfinite(result.disparities)
    assert not known[lf.reference_index][hole(lf)].any()
    assert known[lf.reference_index][~hole(lf)].all()
    assert (result.confidences[~known] == 0).all()


def test_filling_takes_the_farther_side_and_says_so() -> None:
    nan = np.nan
    np.testing.assert_array_equal(lfgpu.fill_unknown([[2.0, nan, nan, -1.0, nan]]), [[2, -1, -1, -1, -1]])
    np.testing.assert_array_equal(lfgpu.fill_unknown([[[nan, 1.0]], [[3.0, nan]]]), [[[1, 1]], [[3, 3]]])
    lf = masked()
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu")
    whole = filled(result)
    assert np.isfinite(whole.disparity).all()
    np.testing.assert_array_equal(whole.disparity[~hole(lf)], result.disparity[~hole(lf)])
    assert "8.3 % of the pixels are not known; they were filled" in whole.status
    assert filled(whole) is whole
    with pytest.raises(LightFieldError, match="no known value"):
        lfgpu.fill_unknown([[nan]])
    with pytest.raises(LightFieldError, match=r"must be \[y, x\]"):
        lfgpu.fill_unknown([1.0])


def test_the_command_line_says_how_much_is_unknown_and_fills_it(tmp_path: Path) -> None:
    lf = masked()
    np.savez(tmp_path / "lf.npz", views=lf.views, positions=lf.positions, valid=lf.valid)

    def told(out: str, *options: str) -> str:
        return " ".join(said("depth", tmp_path / "lf.npz", "-o", tmp_path / out, "--preset", "fast", *options).split())

    text = told("holes")
    assert "8.3 % of the pixels (NaN): masked in this view; --fill fills them" in text
    assert "nan to" not in text
    assert np.isnan(lfgpu.load(tmp_path / "holes" / "disparity.pfm").disparity).sum() == hole(lf).sum()
    assert "8.3 % of the pixels are not known; they were filled" in told("whole", "--fill")
    assert np.isfinite(lfgpu.load(tmp_path / "whole" / "disparity.pfm").disparity).all()
    assert np.isfinite(lfgpu.load(tmp_path / "whole" / "result.npz").disparity).all()
