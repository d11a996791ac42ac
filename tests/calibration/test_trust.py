"""The confidence of a map takes into account where its cameras stand; results keep what was said of them."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import Misalignment, disturb
from lfgpu.cameras.trust import _spread
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.io import read_result, write_hci
from lfgpu.pipelines.verdict import judged

INNER = (slice(15, -15), slice(15, -15))


@pytest.fixture(scope="module")
def planes() -> LightField:
    return scenes.make("planes", grid=(5, 5), size=(128, 144), seed=2, noise=0.004)


def estimated(lf: LightField) -> DepthResult:
    return lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), device="cpu", check_cameras=False)


def right(result: DepthResult, lf: LightField) -> float:
    """The share of pixels within 0.07 of the truth, which the confidence claims to be."""
    assert lf.truth is not None
    return float((np.abs(result.disparity - lf.truth.disparity)[INNER] <= 0.07).mean())


def said(result: DepthResult) -> float:
    return float(result.confidence[INNER].mean())


@pytest.mark.parametrize("how", ["shift=0.5", "roll=0.7"])
def test_confidence_falls_to_what_is_true_where_cameras_are_off(planes: LightField, how: str) -> None:
    wrong = disturb(planes, Misalignment.parse(how), seed=1).light_field
    before = estimated(wrong)
    after = judged(wrong, before, device="cpu")
    assert len(after.remarks) == 1
    assert "line" in after.remarks[0]
    assert before.uncertainty is not None
    assert after.uncertainty is not None
    assert (after.uncertainty > before.uncertainty).all()
    assert planes.truth is not None
    errors = np.abs(after.disparity - planes.truth.disparity)[INNER]
    within = [(errors < result.uncertainty[INNER]).mean() for result in (before, after)]
    assert within[1] > max(0.85, within[0])  # of errors as a Gaussian has them, 0.68
    np.testing.assert_array_equal(after.disparity, before.disparity)


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["shift=0.5", "roll=0.7"])
def test_over_many_arrays_it_falls_to_what_is_true(planes: LightField, how: str) -> None:
    """One array can be lucky: its errors may cancel for the texture that there is."""
    shares, claims, claims_after = [], [], []
    for seed in range(1, 9):
        wrong = disturb(planes, Misalignment.parse(how), seed=seed).light_field
        before = estimated(wrong)
        shares.append(right(before, planes))
        claims.append(said(before))
        claims_after.append(said(judged(wrong, before, device="cpu")))
    share, claim, claim_after = (float(np.mean(values)) for values in (shares, claims, claims_after))
    assert claim > share + 0.15
    assert abs(claim_after - share) < 0.6 * (claim - share)


@pytest.mark.parametrize("how", ["shift=0.5", "roll=0.7"])
def test_uncertainty_grows_where_cameras_are_off(planes: LightField, how: str) -> None:
    wrong = disturb(planes, Misalignment.parse(how), seed=1).light_field
    before = estimated(wrong)
    after = judged(wrong, before, device="cpu")
    assert before.uncertainty is not None
    assert after.uncertainty is not None
    grown = np.nanmedian(after.uncertainty) / np.nanmedian(before.uncertainty)
    assert grown > 1.1  # not more: what such cameras do to costs makes it large before


def test_rotations_count_more_away_from_the_middle(planes: LightField) -> None:
    wrong = disturb(planes, Misalignment(roll=0.7), seed=1).light_field
    before = estimated(wrong)
    share = judged(wrong, before, device="cpu").confidence / np.maximum(before.confidence, 1e-6)
    assert share[64, 72] > share[15, 15] + 0.1


def test_nothing_changes_where_cameras_are_right(planes: LightField) -> None:
    result = estimated(planes)
    after = judged(planes, result, device="cpu")
    assert (after.notes, after.remarks) == (result.notes, ())
    assert after.confidence is result.confidence


def test_brightness_is_said_and_leaves_the_confidence(planes: LightField) -> None:
    wrong = disturb(planes, Misalignment(gain=0.1), seed=1).light_field
    result = estimated(wrong)
    after = judged(wrong, result, device="cpu")
    assert "brightness" in after.remarks[0]
    np.testing.assert_array_equal(after.confidence, result.confidence)


@pytest.mark.parametrize("memory", [None, "1GiB"])
def test_estimate_depth_looks_and_the_pipeline_does_not(planes: LightField, memory: str | None) -> None:
    wrong = disturb(planes, Misalignment(shift=0.5), seed=1).light_field
    found = lfgpu.estimate_depth(wrong, config="fast", disparity_range=(-2, 2), device="cpu", max_memory=memory)
    assert "out of line" in found.remarks[0]
    assert found.remarks[0] in repr(found)
    pipeline = lfgpu.DepthPipeline(wrong, config="fast", disparity_range=(-2, 2), device="cpu")
    before = pipeline.estimate()
    assert before.remarks == ()
    assert said(found) < said(before) - 0.1
    np.testing.assert_array_equal(found.disparity, before.disparity)


def test_the_spread_is_how_far_each_view_moves_a_pixel(planes: LightField, rng: np.random.Generator) -> None:
    """Shift, turn (from x to y) and scale of each view as a matrix, applied to pixels of a corner and of the middle."""
    count, used = len(planes.views), [0, 4, 7, 20]
    shift, turn, scale = rng.normal(0, 0.5, (count, 2)), rng.normal(0, 0.01, count), rng.normal(0, 0.01, count)
    found = SimpleNamespace(shift=shift, rotation=np.rad2deg(turn), scale=scale)
    spread = _spread(planes, found, used)  # type: ignore[arg-type]
    moving = np.array([[scale, -turn, shift[:, 0]], [turn, scale, shift[:, 1]]]).transpose(2, 0, 1)
    for y, x in ((0, 0), (127, 5), (64, 72), (3, 140)):
        moved = moving @ np.array([x - 143 / 2, y - 127 / 2, 1.0])
        want = np.sqrt((moved**2).sum(1).mean() / (planes.offsets[used] ** 2).sum())
        np.testing.assert_allclose(spread[y, x], want, rtol=1e-5)


def test_a_map_that_says_nothing_of_the_cameras_is_a_result_all_the_same() -> None:
    valid = np.ones((9, 32, 32), np.bool_)
    valid[4] = False  # the reference shows next to nothing
    valid[4, 12:20, 12:20] = True
    lf = replace(scenes.make("planes", grid=(3, 3), size=(32, 32), seed=1), valid=valid, truth=None)
    found = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), device="cpu")
    assert np.isnan(found.disparity).sum() == 32**2 - 8**2
    assert found.remarks == ()


def test_depth_says_it_and_writes_it(planes: LightField, tmp_path: Path) -> None:
    wrong = disturb(planes, Misalignment(shift=0.5), seed=1).light_field
    write_hci(wrong, tmp_path / "lf")
    options = ["--preset=fast", "--disparity-range=-2,2", "--device=cpu"]
    outcome = CliRunner().invoke(app, ["depth", str(tmp_path / "lf"), "-o", str(tmp_path / "out"), *options])
    assert outcome.exit_code == 0, outcome.output
    assert "out of line" in outcome.stdout
    result = read_result(tmp_path / "out" / "result.npz")
    assert len(result.remarks) == 1
    assert said(result) < said(estimated(wrong)) - 0.1
    with np.load(tmp_path / "out" / "result.npz") as arrays:
        assert json.loads(str(arrays["lfgpu"]))["remarks"] == list(result.remarks)
