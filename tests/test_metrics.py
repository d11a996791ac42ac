"""The benchmark's measures against values worked out by hand, and the folder that the HCI benchmark takes."""

import re
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu, refused, said
from PIL import Image

from lfgpu.data.lightfield import GroundTruth
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map, write_hci, write_pfm
from lfgpu.io.hci_submission import SCENES, read_region_masks, write_submission
from lfgpu.metrics import Metrics, Sparsification, evaluate, evaluate_regions, other_unit, reliability, sparsification
from lfgpu.scenes import make
from tests.made import made_result

NAN = float("nan")


def test_values_by_hand() -> None:
    truth = np.zeros((2, 4))
    # 0.25^2 + 0.5^2 = 0.3125 over 8 pixels; sorted |error|: 0 0 0 0 0.015625 0.03125 0.25 0.5
    disparity = [[0, 0.25, -0.5, 0.03125], [0, 0, 0.015625, 0]]
    m = evaluate(disparity, truth, border=0)
    mse = (0.25**2 + 0.5**2 + 0.03125**2 + 0.015625**2) / 8
    assert m.mse_100 == pytest.approx(100 * mse)
    assert m.rmse == pytest.approx(mse**0.5)
    assert (m.badpix_07, m.badpix_03, m.badpix_01) == (25.0, 37.5, 50.0)
    assert m.q25 == 0.0
    assert (m.undefined, m.count) == (0.0, 8)
    # sorted |error| 1 2 3 4 5: the 25 % quantile is the second one
    assert evaluate([[-5, 4, -3, 2, 1]], np.zeros((1, 5)), border=0).q25 == 200.0
    m = evaluate([[0.07, 0.03, 0.01, 0.0701]], np.zeros((1, 4)), border=0)
    assert (m.badpix_07, m.badpix_03, m.badpix_01) == (25.0, 50.0, 75.0)
    truth = np.random.default_rng(0).normal(size=(40, 50)).astype(np.float32)
    m = evaluate(truth, truth)
    assert m == Metrics(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10 * 20)


def test_what_is_scored() -> None:
    disparity = np.full((40, 41), 9.0)
    disparity[15:25, 15:26] = 0.5
    m = evaluate(disparity, np.zeros((40, 41)))
    assert m.rmse == 0.5
    assert m.count == 10 * 11
    disparity[14, 20] = disparity[20, 26] = 1e9
    assert evaluate(disparity, np.zeros((40, 41))) == m
    disparity = np.array([[1.0, 0.0], [1.0, 1.0]])
    m = evaluate(disparity, np.zeros((2, 2)), mask=[[True, True], [False, False]], border=0)
    assert (m.count, m.badpix_07, m.mse_100) == (2, 50.0, 50.0)
    m = evaluate([[0.0, 5.0, 5.0, 0.5]], [[0.0, NAN, np.inf, 0.0]], border=0)
    assert (m.count, m.badpix_07, m.rmse) == (2, 50.0, pytest.approx(0.125**0.5))
    assert evaluate(np.zeros((31, 31)), np.zeros((31, 31))).count == 1


@pytest.mark.parametrize("undefined", [NAN, np.inf, -np.inf])
def test_undefined_pixels_are_bad_but_leave_the_mean_alone(undefined: float) -> None:
    m = evaluate([[undefined, 0.0, 0.5, 0.0]], np.zeros((1, 4)), border=0)
    assert (m.badpix_07, m.badpix_01) == (50.0, 50.0)
    assert m.undefined == 25.0
    assert m.rmse == pytest.approx((0.25 / 3) ** 0.5)
    assert "25.00 % undefined" in str(m)


def test_an_estimate_without_any_defined_pixel() -> None:
    m = evaluate(np.full((2, 2), NAN), np.zeros((2, 2)), border=0)
    assert (m.badpix_07, m.badpix_03, m.badpix_01, m.undefined) == (100.0, 100.0, 100.0, 100.0)
    assert np.isnan([m.mse_100, m.rmse, m.q25]).all()


@pytest.mark.parametrize(
    ("disparity", "truth", "options", "words"),
    [
        (np.zeros((4, 4)), np.zeros((4, 5)), {"border": 0}, ["same shape", "(4, 4)", "(4, 5)"]),
        (np.zeros(4), np.zeros(4), {"border": 0}, ["[y, x]", "(4,)"]),
        (np.zeros((30, 40)), np.zeros((30, 40)), {}, ["border", "30 x 40", "15"]),
        (np.zeros((30, 40)), np.zeros((30, 40)), {"border": -1}, ["border", "-1"]),
        (np.zeros((30, 40)), np.zeros((30, 40)), {"border": 2.5}, ["border must be a whole number", "2.5"]),
        (np.zeros((4, 4)), np.full((4, 4), NAN), {"border": 0}, ["nothing to score"]),
        (np.zeros((4, 4)), np.zeros((4, 4)), {"border": 0, "mask": np.zeros((4, 4), bool)}, ["nothing to score"]),
        (np.zeros((4, 4)), np.zeros((4, 4)), {"border": 0, "mask": np.ones((4, 3), bool)}, ["mask", "(4, 3)"]),
        (np.zeros((4, 4)), np.zeros((4, 4)), {"border": 0, "mask": np.ones((4, 4))}, ["mask", "float64"]),
    ],
)
def test_bad_input_is_said_so(disparity: object, truth: object, options: dict[str, object], words: list[str]) -> None:
    with pytest.raises(LightFieldError) as error:
        evaluate(disparity, truth, **options)  # type: ignore[arg-type]
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize(
    ("function", "arguments", "words"),
    [
        (sparsification, {"threshold": "much"}, "threshold must be a number of at least 0, not 'much'"),
        (sparsification, {"confidence": "high"}, "confidence must be that of a result or an array"),
        (evaluate_regions, {"masks": {"fine": [[1] * 4] * 4}}, r"the mask fine must be bool \(4, 4\), found int64"),
        (evaluate_regions, {"masks": {}, "truth": np.zeros((4, 5))}, "the same shape"),
        (evaluate_regions, {"masks": {}, "border": 0.5}, "border must be a whole number"),
    ],
)
def test_other_measures_say_so_too(function, arguments: dict[str, object], words: str) -> None:
    ones = np.ones((4, 4))
    known = {"confidence": ones} if function is sparsification else {}
    with pytest.raises(LightFieldError, match=words):
        function(ones, **{"truth": ones, "border": 0, **known, **arguments})


def test_truth_in_lists_is_scored() -> None:
    truth = GroundTruth([[0, 1], [2, 3]], (0, 0), [[True, True], [True, False]])  # type: ignore[arg-type]
    assert evaluate([[0, 1], [2, 9]], truth, border=0).mse_100 == 0
    assert evaluate_regions(truth.disparity, truth.disparity, {"fine": [[True, False]] * 2}, border=0)


def test_masked_numbers_are_unknown() -> None:
    truth = GroundTruth(np.ma.masked_greater([[0.0, 1.0, 9.0]], 5), (0, 0))
    assert evaluate([[0.0, 1.0, 1.0]], truth, border=0).count == 2
    estimate = np.ma.masked_less([[0, 1, 2]], 1)
    assert evaluate(estimate, np.array([[0.0, 1.0, 2.0]]), border=0).undefined == pytest.approx(100 / 3)


# --- sparsification ---


def curve_of(errors: object, confidence: object, **options: object) -> Sparsification:
    """The curve of a map of one row."""
    row = np.atleast_2d(np.asarray(errors, np.float64))
    return sparsification(row, np.atleast_2d(confidence), np.zeros_like(row), border=0, **options)  # type: ignore[arg-type]


def rows_of(curve: Sparsification) -> dict[int, tuple[float, float]]:
    """(bad, oracle) by the percentage kept."""
    return {round(k): (b, o) for k, b, o in zip(curve.kept, curve.bad, curve.oracle, strict=True)}


TWENTY = np.where(np.arange(20) < 4, 0.5, 0.0)  # the first four of twenty pixels are bad


def test_the_curve_is_between_all_right_and_all_wrong() -> None:
    curve = curve_of(TWENTY, np.arange(20))
    assert list(np.round(curve.kept)) == list(range(100, 0, -5))
    # 20, 19, 18, 17, 16, 15 .. pixels are kept, and 4, 3, 2, 1, 0, 0 .. of them bad
    np.testing.assert_allclose(curve.bad, [20, 300 / 19, 200 / 18, 100 / 17, *[0] * 16], atol=1e-9)
    np.testing.assert_allclose(curve.oracle, curve.bad, atol=1e-9)
    assert curve.ause == pytest.approx(0, abs=1e-12)
    assert (curve.monotone, curve.threshold, curve.count) == (True, 0.07, 20)
    curve = curve_of(TWENTY, -np.arange(20))
    rows = rows_of(curve)
    assert rows[100] == pytest.approx((20, 20))
    assert rows[50] == pytest.approx((40, 0))
    assert rows[20] == rows[5] == pytest.approx((100, 0))
    assert not curve.monotone
    curve = curve_of(TWENTY, np.full(20, 0.3))
    np.testing.assert_allclose(curve.bad, 20)
    assert curve.monotone
    # a trapezoid over 20 shares of 1 - oracle / 20 %, the oracle being (k - 16) / k for k > 16 kept and 0 below
    difference = [1 - 5 * max(0, (k - 16) / k) for k in range(1, 21)]
    assert curve.ause == pytest.approx(0.05 * (sum(difference) - (difference[0] + difference[-1]) / 2))
    assert curve.ause < 0.95
    # ten sure pixels, one of them bad; ten unsure ones, three of them bad
    errors = np.zeros(20)
    errors[[2, 10, 11, 12]] = 0.5
    confidence = np.repeat([0.9, 0.1], 10)
    rows = rows_of(curve_of(errors, confidence))
    assert rows[25][0] == rows[50][0] == pytest.approx(10)
    assert rows[75][0] == pytest.approx(100 * (1 + 1.5) / 15)
    mixed = np.random.default_rng(1).permutation(20)
    np.testing.assert_allclose(curve_of(errors[mixed], confidence[mixed]).bad, curve_of(errors, confidence).bad)


def test_what_the_curve_counts(rng: np.random.Generator) -> None:
    # 95 % of four pixels are 3.8: three sure good ones and 0.8 of the bad one
    rows = rows_of(curve_of([1, 0, 0, 0], [0.1, 0.2, 0.3, 0.4]))
    assert rows[95] == pytest.approx((100 * 0.8 / 3.8, 100 * 0.8 / 3.8))
    assert rows[75] == (0, 0)
    errors, confidence = rng.normal(0, 0.1, 200), rng.random(200)
    one, other = curve_of(errors, confidence), curve_of(errors, np.exp(9 * confidence))
    np.testing.assert_array_equal(one.bad, other.bad)
    assert one.ause == other.ause
    assert rows_of(one)[100][0] == pytest.approx(evaluate([errors], np.zeros((1, 200)), border=0).badpix_07)
    assert rows_of(curve_of([0.07, 0.0701], [1, 0]))[100][0] == 50
    assert rows_of(curve_of([0.07, 0.0701], [1, 0], threshold=0.03))[100][0] == 100
    assert rows_of(curve_of([0.07, 0.0701], [1, 0], threshold=0.1))[100][0] == 0
    curve = curve_of([NAN, 0, 0, 0], [0.9, 0.1, 0.2, 0.3])
    assert rows_of(curve)[25] == pytest.approx((100, 0))
    assert rows_of(curve_of([0.5, 0, 0, 0], [NAN, 0, 0.2, 0.3]))[75][0] == 0
    curve = curve_of(np.zeros(8), np.arange(8))
    assert np.isnan(curve.ause)
    assert curve.monotone
    assert not curve.bad.any()
    truth, mask = np.zeros((40, 44)), rng.random((40, 44)) < 0.5
    disparity, confidence = rng.normal(0, 0.1, truth.shape), rng.random(truth.shape)
    truth[20, 20], mask[20, 20:22] = NAN, True
    curve = sparsification(disparity, confidence, truth, mask=mask)
    inner = np.zeros_like(mask)
    inner[15:-15, 15:-15] = True
    scored = inner & mask & np.isfinite(truth)
    assert curve.count == scored.sum()
    np.testing.assert_array_equal(curve.bad, curve_of(disparity[scored], confidence[scored]).bad)


# --- reliability ---


def test_reliability_counts_what_is_right_in_each_bin() -> None:
    truth = np.zeros((10, 10))
    said = np.full((10, 10), 0.25)
    said[5:] = 0.95
    found = np.zeros((10, 10))
    found[0] = 0.08  # a fifth of the unsure pixels is off
    found[9, :5] = np.nan  # undefined is wrong
    diagram = reliability(found, said, truth, border=0)
    np.testing.assert_allclose(diagram.said, [0.25, 0.95])
    np.testing.assert_allclose(diagram.right, [80, 90])
    np.testing.assert_allclose(diagram.share, [50, 50])
    assert diagram.count == 100
    assert "25 -> 80.0" in repr(diagram)
    assert reliability(found, said, truth, border=0, threshold=0.1).right[0] == 100
    said[0] = np.nan
    assert reliability(found, said, truth, border=0).count == 90, "what has no confidence is in no bin"
    assert reliability(found, np.ones((10, 10)), truth, border=0).said == [1.0]


@pytest.mark.parametrize("said", [-0.1, 1.1])
def test_a_confidence_that_is_no_share_has_no_reliability(said: float) -> None:
    with pytest.raises(LightFieldError, match="must be from 0 to 1"):
        reliability(np.zeros((4, 4)), np.full((4, 4), said), np.zeros((4, 4)), border=0)


def test_a_map_in_another_unit_or_with_the_opposite_sign_is_told() -> None:
    rng = np.random.default_rng(5)
    truth = np.repeat(np.linspace(-1.0, 2.0, 60)[None], 40, axis=0) + rng.normal(0, 0.01, (40, 60))
    noisy = truth + rng.normal(0, 0.02, truth.shape)
    noisy[3] = np.nan
    assert other_unit(noisy, truth) is None
    assert "opposite sign of the truth: turn" in str(other_unit(-noisy, truth))
    assert "-4" not in str(other_unit(-4 * noisy, truth))
    assert "is 4 times as large" in str(other_unit(-4 * noisy, truth))
    assert "The map is 4 times as large as the truth" in str(other_unit(4 * noisy, truth))
    assert "depth and not disparity" in str(other_unit(1 / (noisy + 3), truth))
    assert other_unit(rng.normal(0, 1, truth.shape), truth) is None
    assert other_unit(noisy, np.zeros_like(truth)) is None


MAP = np.linspace(-1, 1, 512 * 512, dtype=np.float32).reshape(512, 512)


def test_the_folder_of_a_submission(tmp_path: Path) -> None:
    missing = write_submission(tmp_path / "out", {"cotton": (MAP, 1.25), "dots": (MAP + 1, 3.0)})
    assert set(missing) == set(SCENES) - {"cotton", "dots"}
    names = sorted(str(file.relative_to(tmp_path / "out")) for file in (tmp_path / "out").rglob("*.*"))
    assert names == ["disp_maps/cotton.pfm", "disp_maps/dots.pfm", "runtimes/cotton.txt", "runtimes/dots.txt"]
    np.testing.assert_array_equal(read_map(tmp_path / "out" / "disp_maps" / "dots.pfm"), MAP + 1)
    assert float((tmp_path / "out" / "runtimes" / "cotton.txt").read_text()) == 1.25


@pytest.mark.parametrize(
    ("scene", "disparity", "seconds", "words"),
    [
        ("kitchen", MAP, 1.0, "'kitchen' is no scene of the benchmark"),
        ("dots", MAP[:-1], 1.0, "the map of dots is 512 x 511"),
        ("dots", np.where(MAP > 0.999, np.nan, MAP), 1.0, "undefined in "),
        ("dots", MAP, 0.0, "the runtime of dots must be a positive number"),
        ("dots", MAP, float("nan"), "the runtime of dots must be a positive number"),
    ],
)
def test_what_the_benchmark_does_not_take(
    scene: str, disparity: np.ndarray, seconds: float, words: str, tmp_path: Path
) -> None:
    with pytest.raises(LightFieldError, match=re.escape(words)):
        write_submission(tmp_path / "out", {"cotton": (MAP, 1.0), scene: (disparity, seconds)})
    assert not (tmp_path / "out").exists()


def test_a_submission_from_what_depth_wrote(tmp_path: Path) -> None:
    (tmp_path / "Cotton").mkdir()
    made_result(MAP, timings={"total": 1.5}).save(tmp_path / "Cotton" / "result.npz")
    text = " ".join(said("eval", tmp_path / "Cotton", "--hci-submission", tmp_path / "sent").split())
    assert "11 are missing: backgammon, dots" in text
    stored = read_map(tmp_path / "sent" / "disp_maps" / "cotton.pfm")
    np.testing.assert_array_equal(stored, MAP)
    assert float((tmp_path / "sent" / "runtimes" / "cotton.txt").read_text()) == 1.5
    write_pfm(tmp_path / "dots.pfm", MAP)
    outcome = lfgpu("eval", tmp_path / "dots.pfm", "--hci-submission", tmp_path / "x")
    refused(outcome, "does not say how long it took")


def test_measures_of_regions() -> None:
    truth = np.zeros((60, 80))
    found = truth.copy()
    found[20, 30:40] = 0.2  # too near
    found[40, 30:40] = -0.2  # too far
    found[30, 30:35] = np.nan
    everywhere = np.ones(truth.shape, np.bool_)
    masks = {"discontinuities": everywhere, "fine": everywhere, "fine_surrounding": everywhere}
    scores = evaluate_regions(found, truth, masks, border=15)
    inside = (60 - 30) * (80 - 30) / 100
    assert scores["discontinuities"] == pytest.approx(25 / inside)
    assert scores["fine structures, fattening"] == pytest.approx(15 / inside)
    assert scores["fine structures, thinning"] == pytest.approx(15 / inside)
    assert "planes, bumpiness" not in scores


def test_bumpiness_is_that_of_second_derivatives() -> None:
    y, x = np.mgrid[:60, :80].astype(np.float64)
    truth = 0.3 * x - 0.2 * y
    masks = {"planes": np.ones(truth.shape, np.bool_)}
    for found, bumpy in ((truth + 0.01 * x + 5, 0.0), (truth + 0.005 * x**2, 1.0), (truth + 0.005 * x * y, 0.5**0.5)):
        assert evaluate_regions(found, truth, masks)["planes, bumpiness"] == pytest.approx(bumpy, abs=1e-9)
    assert evaluate_regions(truth + x**3, truth, masks)["planes, bumpiness"] == pytest.approx(5.0)  # at most


def test_eval_shows_the_regions_that_a_scene_has(tmp_path: Path) -> None:
    lf = make("boxes", grid=(3, 3), size=(48, 56))
    write_hci(lf, tmp_path / "scene")
    write_pfm(tmp_path / "map.pfm", lf.truth.disparity + np.float32(0.1))
    assert "discontinuities" not in said("eval", tmp_path / "map.pfm", tmp_path / "scene")
    mask = Image.fromarray(np.full((48, 56), 255, np.uint8))
    mask.save(tmp_path / "scene" / "mask_discontinuities_lowres.png")
    (tmp_path / "scene" / "evaluation_masks").mkdir()
    mask.save(tmp_path / "scene" / "evaluation_masks" / "mask_planes.png")
    assert set(read_region_masks(tmp_path / "scene")) == {"discontinuities", "planes"}
    text = said("eval", tmp_path / "map.pfm", tmp_path / "scene")
    assert re.search(r"discontinuities \(%\) +100.00", text)
    assert re.search(r"planes, bumpiness \(x100\) +0.00", text)
