"""The benchmark's measures against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from lfgpu.errors import LightFieldError
from lfgpu.metrics import Metrics, evaluate

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


def test_q25_is_the_quantile_of_absolute_errors_times_100() -> None:
    # sorted |error| 1 2 3 4 5: the 25 % quantile is the second one
    assert evaluate([[-5, 4, -3, 2, 1]], np.zeros((1, 5)), border=0).q25 == 200.0


def test_badpix_counts_only_what_is_strictly_worse() -> None:
    m = evaluate([[0.07, 0.03, 0.01, 0.0701]], np.zeros((1, 4)), border=0)
    assert (m.badpix_07, m.badpix_03, m.badpix_01) == (25.0, 50.0, 75.0)


def test_a_perfect_map_scores_zero() -> None:
    truth = np.random.default_rng(0).normal(size=(40, 50)).astype(np.float32)
    m = evaluate(truth, truth)
    assert m == Metrics(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10 * 20)


def test_the_border_is_left_out() -> None:
    disparity = np.full((40, 41), 9.0)
    disparity[15:25, 15:26] = 0.5
    m = evaluate(disparity, np.zeros((40, 41)))
    assert m.rmse == 0.5
    assert m.count == 10 * 11
    disparity[14, 20] = disparity[20, 26] = 1e9
    assert evaluate(disparity, np.zeros((40, 41))) == m


def test_the_mask_says_where_is_scored() -> None:
    disparity = np.array([[1.0, 0.0], [1.0, 1.0]])
    m = evaluate(disparity, np.zeros((2, 2)), mask=[[True, True], [False, False]], border=0)
    assert (m.count, m.badpix_07, m.mse_100) == (2, 50.0, 50.0)


def test_unknown_truth_is_left_out() -> None:
    m = evaluate([[0.0, 5.0, 5.0, 0.5]], [[0.0, NAN, np.inf, 0.0]], border=0)
    assert (m.count, m.badpix_07, m.rmse) == (2, 50.0, pytest.approx(0.125**0.5))


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


def test_the_smallest_map_that_a_border_leaves() -> None:
    assert evaluate(np.zeros((31, 31)), np.zeros((31, 31))).count == 1
