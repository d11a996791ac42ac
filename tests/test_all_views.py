"""Maps of all views: each near its own truth, all of one scene, also where views are masked or stand in one row."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.data import LightField, ViewsResult
from lfgpu.data.filling import fill_unknown
from lfgpu.errors import LightFieldError
from lfgpu.metrics import evaluate
from lfgpu.pipelines.all_views import Join, estimate_all_views, spread_out
from lfgpu.pipelines.estimate import estimate_depth
from tests.made import made_result, masked, thorough

RANGE = (-1.6, 1.7)
SIZE = (96, 96)


@cache
def scene(name: str, grid: tuple[int, int] = (5, 5)) -> LightField:
    return scenes.make(name, grid=grid, size=SIZE)


@cache
def truth(name: str, index: int, grid: tuple[int, int] = (5, 5)) -> np.ndarray:
    return scenes.true_disparity(name, *divmod(index, grid[1]), grid=grid, size=SIZE)


def truths(name: str, grid: tuple[int, int] = (5, 5), step: int = 1) -> np.ndarray:
    return np.stack([truth(name, index, grid) for index in range(0, grid[0] * grid[1], step)])


def filled(result: ViewsResult) -> ViewsResult:
    """Without the holes that no key view sees into."""
    return replace(result, disparities=fill_unknown(result.disparities))


@cache
def estimated(name: str) -> ViewsResult:
    return filled(estimate_all_views(scene(name), config="accurate", disparity_range=RANGE))


@cache
def alone(name: str) -> np.ndarray:
    """Every sixth view estimated as if it were the only one."""
    lf = scene(name)
    return np.stack(
        [
            estimate_depth(lf.with_reference(n), config="accurate", disparity_range=RANGE).disparity
            for n in range(0, 25, 6)
        ]
    )


def differences(maps: np.ndarray, true: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """|d_a(p) - d_b(p - d_a(p) o_ab)| over pixels that both views see, for each view with the next and with the last.

    They do if the true disparity is the same, within 0.1, at the pixels around where p truly lies in b.
    """
    found = []
    height, width = maps.shape[1:]
    y, x = np.mgrid[:height, :width]
    last = len(maps) - 1
    for a, b in [(a, a + 1) for a in range(last)] + [(a, last) for a in range(last)]:
        du, dv = positions[b] - positions[a]
        column, row = x - true[a] * du, y - true[a] * dv
        both = (column >= 1) & (column <= width - 2) & (row >= 1) & (row <= height - 2)
        left, top = (np.clip(np.floor(place).astype(int), 0, height - 2) for place in (column, row))
        for i, j in np.ndindex(2, 2):
            both &= np.abs(true[b][top + i, left + j] - true[a]) < 0.1
        found.append(np.abs(maps[a] - sampled(maps[b], x - maps[a] * du, y - maps[a] * dv))[both])
    return np.concatenate(found)


def sampled(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    left, top = (np.clip(np.floor(place).astype(int), 0, SIZE[0] - 2) for place in (x, y))
    across, down = np.clip(x - left, 0, 1), np.clip(y - top, 0, 1)
    upper = (1 - across) * values[top, left] + across * values[top, left + 1]
    lower = (1 - across) * values[top + 1, left] + across * values[top + 1, left + 1]
    return np.asarray((1 - down) * upper + down * lower)


@pytest.mark.parametrize(("name", "most"), [("boxes", 13), thorough("planes", 6.5)])
def test_every_view_is_near_its_own_truth(name: str, most: float) -> None:
    result = estimated(name)
    assert result.disparities.shape == result.confidences.shape == (25, *SIZE)
    assert result.disparities.dtype == result.confidences.dtype == np.float32
    assert np.isfinite(result.disparities).all()
    found = [evaluate(one, true).badpix_07 for one, true in zip(result.disparities, truths(name), strict=True)]
    assert max(found) < most
    # The truth of one corner is no answer for the other one: views that are mixed up are found.
    assert evaluate(result.disparities[0], truth(name, 24)).badpix_07 > 2 * most


@pytest.mark.parametrize("name", ["boxes", thorough("planes")])
def test_maps_are_better_than_those_of_views_alone_and_agree_more(name: str) -> None:
    true, positions = truths(name, step=6), scene(name).positions[::6]
    both = estimated(name).disparities[::6], alone(name)
    bad = [np.mean([evaluate(d, t).badpix_07 for d, t in zip(maps, true, strict=True)]) for maps in both]
    assert bad[0] < 0.9 * bad[1]
    joint, single = (differences(maps, true, positions) for maps in both)
    assert np.median(joint) < 0.5 * np.median(single)
    assert np.mean(joint > 0.07) < 0.7 * np.mean(single > 0.07)
    assert np.quantile(joint, 0.95) < 0.03


def test_the_true_maps_agree() -> None:
    """The other tests measure nothing but mistakes."""
    true = truths("boxes")
    found = differences(true, true, scene("boxes").positions)
    assert len(found) > 100_000
    assert np.quantile(found, 0.99) < 0.01


def test_depths_confidence_and_the_reference_are_those_of_one_estimate() -> None:
    result, inner = estimated("boxes"), np.s_[:, 15:-15, 15:-15]
    wrong, confidence = np.abs(result.disparities - truths("boxes"))[inner] > 0.07, result.confidences[inner]
    assert ((confidence >= 0) & (confidence <= 1)).all()
    low, high = np.quantile(confidence, (0.3, 0.7))
    assert wrong[confidence >= high].mean() < 0.2 * wrong[confidence <= low].mean()
    lf = scene("boxes")
    np.testing.assert_array_equal(
        result.reference.disparity, estimate_depth(lf, config="accurate", disparity_range=RANGE).disparity
    )
    assert result.keys[0] == lf.reference_index
    assert result.keys == (12, 0, 4, 20, 24, 2, 10, 14, 22)
    assert set(result.timings) == {"keys", "join", "total"}
    np.testing.assert_allclose(result.depths, result.geometry.depth(result.disparities), rtol=1e-6)


def test_a_row_of_views_gets_a_map_each() -> None:
    lf, true = scene("planes", (1, 7)), truths("planes", (1, 7))
    result = estimate_all_views(lf, keys=3, config="fast", disparity_range=RANGE)
    assert result.keys == (3, 0, 6)
    assert max(evaluate(d, t).badpix_07 for d, t in zip(result.disparities, true, strict=True)) < 12


def test_views_and_pixels_that_are_masked_say_nothing_and_get_a_map() -> None:
    lf = replace(scene("planes"), views=scene("planes").views.copy())
    lf = masked(lf, 0, np.s_[4, 30:60, 30:60], np.s_[12, 40:56, 40:56])
    lf.views[~lf.valid] = 255 - lf.views[~lf.valid]
    result = filled(estimate_all_views(lf, keys=5, config="fast", disparity_range=RANGE))
    assert 0 not in result.keys
    for index in (0, 4, 12, 24):
        assert evaluate(result.disparities[index], truth("planes", index)).badpix_07 < 8


def test_any_method_and_backend_will_do(target: Any) -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(32, 32), seed=2)
    options = {"keys": 2, "disparity_range": RANGE, "config": "fast"}
    result = estimate_all_views(lf, backend=target.backend, device=target.device, **options)
    truth = estimate_all_views(lf, backend="reference", **options)
    assert np.nanmax(np.abs(result.disparities - truth.disparities)) < 1e-3
    paper = estimate_all_views(lf, backend=target.backend, device=target.device, **(options | {"config": "paper"}))
    assert np.nanmean(np.abs(paper.disparities - truth.disparities) > 0.1) < 0.06


def test_progress_goes_from_nothing_to_all() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(32, 32))
    said: list[tuple[str, int, float]] = []
    estimate_all_views(lf, keys=2, config="fast", disparity_range=RANGE, on_progress=lambda *what: said.append(what))
    assert said[:3] == [("keys", 0, 0.0), ("keys", 1, 0.5), ("keys", 2, 1.0)]
    assert said[3] == ("join", 0, 0.0)
    assert said[-1] == ("join", 9, 1.0)
    assert len(said) == 13


def test_keys_are_spread_out_and_usable() -> None:
    row = np.stack([np.arange(7.0), np.zeros(7)], 1)
    assert spread_out(row, 3, 1) == [3]
    assert spread_out(row, 3, 3) == [3, 0, 6]
    assert sorted(spread_out(row, 3, 100)) == list(range(7))
    usable = np.array([False, True, True, True, True, True, False])
    assert spread_out(row, 3, 3, usable) == [3, 1, 5]
    assert spread_out(row, 0, 2, np.zeros(7, np.bool_)) == [0]


def joined(
    maps: dict[tuple[float, float], Any], at: tuple[float, float], *, valid: np.ndarray | None = None
) -> tuple[list[float], list[float]]:
    """Disparity and confidence, one row each, of the view `at` (u, v) from one row of each key view."""
    estimates = [
        made_result(np.array([row] * 3, np.float32), confidence=0.8, position=position)
        for position, row in maps.items()
    ]
    disparity, confidence = Join(estimates, valid, Device(load("reference"), "cpu"), tolerance=0.1)(np.array(at))
    return disparity[1].tolist(), confidence[1].tolist()


def test_what_keys_see_decides() -> None:
    disparity, confidence = joined({(0.0, 0.0): [0, 0, 0, 0, 1, 1, 0, 0, 0]}, (2.0, 0.0))
    np.testing.assert_array_equal(disparity, [0, 0, 1, 1, np.nan, np.nan, 0, 0, 0])
    np.testing.assert_allclose(confidence, [0.8, 0.8, 0.8, 0.8, 0, 0, 0.8, 0.8, 0.8])
    # Where only the near thing lands, as the other key has nothing there that it knows.
    valid = np.ones((2, 3, 5), np.bool_)
    valid[1, :, 2] = False
    maps = {(0.0, 0.0): [0.0, 0, 1, 0, 0], (2.0, 0.0): [0.0, 0, 0, 0, 0]}
    disparity, confidence = joined(maps, (0.0, 0.0), valid=valid)
    assert disparity[2] == 1
    assert confidence[2] == pytest.approx(0.4)  # at column 0, the other key sees through it
    assert confidence[1] == pytest.approx(0.8)
    valid = np.ones((1, 3, 5), np.bool_)
    valid[0, :, 2] = False
    maps = {(0.0, 0.0): [0.0, 0, 1, 0, 0]}
    np.testing.assert_array_equal(joined(maps, (0.0, 0.0))[0], [0, 0, 1, 0, 0])
    np.testing.assert_array_equal(joined(maps, (0.0, 0.0), valid=valid)[0], [0, 0, np.nan, 0, 0])


@pytest.mark.parametrize(("near", "winner"), [((0, 1, 2), 0), ((0, 1, 2, -1), 1)])
def test_keys_that_see_through_have_half_a_vote_against(near: tuple[int, ...], winner: float) -> None:
    """Two keys see through what is near, which makes 3 - 2 / 2 votes for it against their 2, or 4 - 2 / 2."""
    maps = {(float(u), 0.0): [float(2 - u <= column <= 6 - u) for column in range(9)] for u in near}
    maps |= {(u, 0.0): [0.0] * 9 for u in (-2.0, 3.0)}
    assert joined(maps, (0.0, 0.0))[0][4] == winner


def test_wrong_numbers_wrong_ranges_and_views_that_see_nothing_are_refused() -> None:
    wrong: list[Any] = [0, -1, 2.5, True, "nine"]
    for keys in wrong:
        with pytest.raises(LightFieldError, match="keys must be an integer >= 1"):
            estimate_all_views(scene("planes"), keys=keys)
    with pytest.raises(LightFieldError, match="low < high"):
        estimate_all_views(scene("planes"), disparity_range=(1.0, -1.0))
    lf = scenes.make("relief", grid=(3, 3), size=(32, 32), disparity_range=(0.5, 1.5))
    away = lf.positions.copy()
    away[8] = (500.0, 0.0)
    with pytest.raises(LightFieldError, match=r"view 8 \(row 0, column 500\) shows nothing .* use more key views"):
        estimate_all_views(LightField(lf.views, away, reference=4), keys=1, config="fast", disparity_range=(0.4, 1.6))
