"""A glance and a screening of cameras, what commands say of them by themselves, and the confidence that follows."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import lfgpu as command
from conftest import real_data
from disturbed import displaced, truth, with_view

import lfgpu
from lfgpu import scenes
from lfgpu._backends import open_device
from lfgpu.calibration import Misalignment, disturb
from lfgpu.cameras import points, surface
from lfgpu.cameras.looking import look, part_of
from lfgpu.cameras.points import Points
from lfgpu.cameras.screening import worth_a_look
from lfgpu.cameras.trust import _spread
from lfgpu.data import DepthResult, LightField
from lfgpu.io import write_hci
from lfgpu.pipelines.verdict import judged
from tests.made import thorough


def glance(lf: LightField) -> str | None:
    """The first finding of a look without a map."""
    found = look(lf, None, open_device("warp", "cpu"), budget="screen")
    return found.findings[0] if found is not None and found.findings else None


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(128, 144), seed=3, noise=0.004)


@pytest.fixture(scope="module")
def out_of_line(boxes: LightField) -> LightField:
    return disturb(boxes, Misalignment(shift=0.5), seed=1).light_field


def test_what_is_wrong_with_all_cameras_is_seen_at_a_glance(boxes: LightField) -> None:
    assert "differ in brightness" in str(glance(disturb(boxes, Misalignment(gain=0.15), seed=1).light_field))
    flipped = replace(boxes, positions=boxes.positions * (1, -1), grid_shape=None, truth=None, geometry=None)
    assert "opposite senses" in str(glance(flipped))


def test_nothing_is_seen_of_single_views_or_nothing(boxes: LightField, rng: np.random.Generator) -> None:
    views = boxes.views.copy()
    views[3] = np.roll(views[3], 1, axis=1)
    assert glance(replace(boxes, views=views)) is None
    assert glance(LightField.from_grid(np.full((3, 3, 32, 32), 100, np.uint8))) is None
    assert glance(LightField.from_grid(rng.integers(0, 255, (3, 3, 64, 64), dtype=np.uint8))) is None


@pytest.mark.parametrize("name", ["lytro_2067", *map(thorough, ("stillLife_3x3", "population/C_fence"))])
def test_real_cameras_raise_no_alarm(name: str) -> None:
    assert glance(lfgpu.read(real_data(name))) is None


def test_the_part_that_is_looked_at_is_bounded_and_keeps_its_places(boxes: LightField) -> None:
    part, (rows, columns) = part_of(boxes, views=9, pixels=9 * 32 * 36)
    assert part.views.shape == (9, 32, 36, 3)
    assert (part.views[part.reference_index] == boxes.views[12, rows, columns]).all()
    assert part.positions[part.reference_index].tolist() == boxes.positions[12].tolist()
    whole, window = part_of(boxes, views=100, pixels=10**9)
    assert whole is boxes
    assert window == (slice(0, 128), slice(0, 144))


def test_a_quick_judgement_finds_what_all_cameras_have(out_of_line: LightField) -> None:
    result = estimated(out_of_line)
    quick = judged(out_of_line, result, device="cpu", in_part=True)
    assert "out of line" in quick.remarks[0]
    assert np.nanmean(quick.confidence) < np.nanmean(result.confidence) - 0.1


def test_info_says_it(boxes: LightField, out_of_line: LightField, tmp_path: Path) -> None:
    said = []
    for name, lf in (("moved", out_of_line), ("right", boxes)):
        write_hci(lf, tmp_path / name)
        said.append(" ".join(command("info", tmp_path / name).out.split()))
    assert "cameras the views are out of line by 0." in said[0]
    assert "out of line" not in said[1]


@pytest.mark.parametrize("name", ["boxes", "planes", "relief", "bars"])
def test_right_cameras_need_no_look(name: str) -> None:
    lf = scenes.make(name, grid=(5, 5), size=(128, 144), seed=4)
    assert not worth_a_look(lf, truth(lf))
    partly = truth(lf).copy()
    partly[:, :40] = np.nan
    assert not worth_a_look(lf, partly)
    valid = np.ones(lf.views.shape[:3], np.bool_)
    valid[:, :30] = False
    masked = replace(lf, views=np.where(valid[..., None], lf.views, 0), valid=valid)
    assert not worth_a_look(masked, truth(lf))


@pytest.mark.parametrize(
    ("index", "change"),
    [
        (3, lambda image: displaced(image, x=0.15)),
        (12, lambda image: displaced(image, y=-0.15)),
        (20, lambda image: displaced(image, degrees=-0.15)),
        (7, lambda image: 0.95 * image),
        (3, lambda image: displaced(image, x=2.5, y=-1)),
        (20, lambda image: np.roll(image, 30, axis=0)),
        (7, lambda image: 0 * image),
    ],
)
def test_a_single_view_is_worth_it(boxes: LightField, index: int, change) -> None:
    """The reference view, 12, among them, and views so far off that all their points are outliers."""
    assert worth_a_look(with_view(boxes, index, change), truth(boxes))


@pytest.mark.parametrize("how", ["shift=0.15", "roll=0.2", "scale=0.003", "gain=0.05"])
def test_all_cameras_together_are_worth_it(boxes: LightField, how: str) -> None:
    assert worth_a_look(disturb(boxes, Misalignment.parse(how), seed=1).light_field, truth(boxes))


@pytest.mark.parametrize("preset", ["fast", thorough("accurate")])
@pytest.mark.parametrize("matrix", [thorough(((1, 0), (0, -1))), thorough(((-1, 0), (0, -1))), ((0, 1), (1, 0))])
def test_wrong_axes_are_worth_it(
    boxes: LightField, matrix: tuple[tuple[int, int], tuple[int, int]], preset: str
) -> None:
    positions = boxes.positions @ np.array(matrix, float).T
    lf = replace(boxes, positions=positions, grid_shape=None, truth=None, geometry=None)
    assert worth_a_look(lf, lfgpu.estimate_depth(lf, config=preset, device="cpu").disparity)


def test_no_look_is_taken_where_none_is_worth_it(boxes: LightField, monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[LightField] = []

    def choose_points(lf: LightField, *arguments: object, **options: object) -> Points:
        looks.append(lf)
        return points.choose_points(lf, *arguments, **options)

    monkeypatch.setattr("lfgpu.cameras.looking.choose_points", choose_points)
    result = estimated(boxes)
    assert judged(boxes, result, device="cpu").remarks == ()
    assert not looks
    moved = with_view(boxes, 3, lambda image: np.roll(image, 1, axis=1))
    judged(moved, result, device="cpu")
    assert len(looks) == 1


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("apart", [False, True])
def test_views_are_looked_up_as_on_their_surfaces(dtype: type, apart: bool, rng: np.random.Generator) -> None:
    """Wherever the pixels of a row lie in memory."""
    views = (rng.random((4, 3, 20, 24)) * (1 if dtype is np.float32 else np.iinfo(dtype).max)).astype(dtype)
    views = views.transpose(0, 2, 3, 1) if apart else np.ascontiguousarray(views.transpose(0, 2, 3, 1))
    lf, index = LightField(views, np.array([(0.0, 0.0), (1, 0), (0, 1), (1, 1)])), np.array([1, 3])
    y, x = rng.uniform(1, 17, (2, 50)), rng.uniform(1, 21, (2, 50))
    want = [surface.Surface(views[n], lf.scale)(x[k], y[k])[0] for k, n in enumerate(index)]
    np.testing.assert_allclose(surface.looked_up(lf, index, y, x), want, atol=1e-6)
    row, column = y[0].astype(int), x[0].astype(int)
    want = surface.Surface(views[lf.reference_index], lf.scale)(column.astype(float), row.astype(float))
    np.testing.assert_allclose(surface.with_slopes(lf, row, column), want, atol=1e-6)


@pytest.mark.parametrize("index", [0, 3, 22])
def test_what_is_hidden_lands_where_something_nearer_lands(boxes: LightField, index: int) -> None:
    """Against a z-buffer: the nearest of all pixels of the reference that land beside a point."""
    map_, (du, dv) = truth(boxes), boxes.offsets[index]
    height, width = boxes.size
    y, x = (grid.ravel() for grid in np.mgrid[8 : height - 8 : 3, 8 : width - 8 : 3])
    rows, columns = np.mgrid[:height, :width]
    at_x, at_y = columns - map_ * du, rows - map_ * dv
    want = []
    for row, column in zip(y, x, strict=True):
        lands = (np.abs(at_x - at_x[row, column]) < 0.5) & (np.abs(at_y - at_y[row, column]) < 0.5)
        want.append(map_[lands].max() - map_[row, column] > 1.2 / np.hypot(*boxes.offsets.T).max())
    found = points.hidden(boxes, map_, y, x, np.array([index]))[0]
    assert 0.01 < np.mean(want) < 0.5
    assert (found == np.array(want)).mean() > 0.98


INNER = (slice(15, -15), slice(15, -15))


@cache
def planes() -> LightField:
    return scenes.make("planes", grid=(5, 5), size=(128, 144), seed=2, noise=0.004)


def estimated(lf: LightField) -> DepthResult:
    return lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), device="cpu", check_cameras=False)


@cache
def looked_at(how: str, seed: int = 1) -> tuple[DepthResult, DepthResult]:
    """A result, before and after its cameras are looked at, which are misaligned if that is told."""
    lf = disturb(planes(), Misalignment.parse(how), seed=seed).light_field if how else planes()
    before = estimated(lf)
    return before, judged(lf, before, device="cpu")


def right(result: DepthResult) -> float:
    """The share of pixels within 0.07 of the truth, which the confidence claims to be."""
    return float((np.abs(result.disparity - truth(planes()))[INNER] <= 0.07).mean())


def said(result: DepthResult) -> float:
    return float(result.confidence[INNER].mean())


@pytest.mark.parametrize("how", [thorough("shift=0.5"), "roll=0.7"])
def test_confidence_falls_to_what_is_true_where_cameras_are_off(how: str) -> None:
    before, after = looked_at(how)
    assert len(after.remarks) == 1
    assert "line" in after.remarks[0]
    assert before.uncertainty is not None
    assert after.uncertainty is not None
    assert (after.uncertainty > before.uncertainty).all()
    errors = np.abs(after.disparity - truth(planes()))[INNER]
    within = [(errors < result.uncertainty[INNER]).mean() for result in (before, after)]
    assert within[1] > max(0.85, within[0])  # of errors as a Gaussian has them, 0.68
    np.testing.assert_array_equal(after.disparity, before.disparity)


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["shift=0.5", "roll=0.7"])
def test_over_many_arrays_it_falls_to_what_is_true(how: str) -> None:
    """One array can be lucky: its errors may cancel for the texture that there is."""
    pairs = [looked_at(how, seed) for seed in range(1, 9)]
    share, claim, claim_after = np.mean([(right(before), said(before), said(after)) for before, after in pairs], axis=0)
    assert claim > share + 0.15
    assert abs(claim_after - share) < 0.6 * (claim - share)


def test_rotations_count_more_away_from_the_middle() -> None:
    before, after = looked_at("roll=0.7")
    share = after.confidence / np.maximum(before.confidence, 1e-6)
    assert share[64, 72] > share[15, 15] + 0.1


def test_right_cameras_change_nothing_and_brightness_no_confidence() -> None:
    result, after = looked_at("")
    assert (after.notes, after.remarks) == (result.notes, ())
    assert after.confidence is result.confidence
    result, after = looked_at("gain=0.1")
    assert "brightness" in after.remarks[0]
    np.testing.assert_array_equal(after.confidence, result.confidence)


def test_the_spread_is_how_far_each_view_moves_a_pixel(rng: np.random.Generator) -> None:
    """Shift, turn (from x to y) and scale of each view as a matrix, applied to pixels of a corner and of the middle."""
    count, used = len(planes().views), [0, 4, 7, 20]
    shift, turn, scale = rng.uniform(-0.5, 0.5, (count, 2)), rng.normal(0, 0.01, count), rng.normal(0, 0.01, count)
    alone = np.full((1, 2), 30.0), np.array([0.2]), np.array([0.3])  # one that is far off draws nothing
    shifts, turns, scales = (np.concatenate(parts) for parts in zip((shift, turn, scale), alone, strict=True))
    offsets = np.concatenate([planes().offsets, [(0.5, 0.5)]])
    found = SimpleNamespace(
        shift=shifts, shift_error=0 * shifts, rotation=np.rad2deg(turns), scale=scales, offsets=offsets
    )
    spread = _spread(planes(), found, used)  # type: ignore[arg-type]
    moving = np.array([[scale, -turn, shift[:, 0]], [turn, scale, shift[:, 1]]]).transpose(2, 0, 1)
    for y, x in ((0, 0), (127, 5), (64, 72), (3, 140)):
        moved = moving @ np.array([x - 143 / 2, y - 127 / 2, 1.0])
        want = np.sqrt((moved**2).sum(1).mean() / (planes().offsets[used] ** 2).sum())
        np.testing.assert_allclose(spread[y, x], want, rtol=1e-5)


def test_a_map_that_says_nothing_of_the_cameras_is_a_result_all_the_same() -> None:
    valid = np.ones((9, 32, 32), np.bool_)
    valid[4] = False  # the reference shows next to nothing
    valid[4, 12:20, 12:20] = True
    lf = replace(scenes.make("planes", grid=(3, 3), size=(32, 32), seed=1), valid=valid, truth=None)
    found = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), device="cpu")
    assert np.isnan(found.disparity).sum() == 32**2 - 8**2
    assert found.remarks == ()
