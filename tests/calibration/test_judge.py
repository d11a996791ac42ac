"""The judge: which camera stands out and how, whether signs are right, and silence where all is well."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu as command, refused, said
from disturbed import displaced, explained, truth, with_view
from scipy import ndimage

import lfgpu
from lfgpu import Explanation, scenes
from lfgpu.calibration import residual_pictures
from lfgpu.cameras import consensus
from lfgpu.cameras.consensus import outliers, without_gauge
from lfgpu.cameras.looking import seen_views
from lfgpu.cameras.signs import near_and_far_swapped, order_of_depth
from lfgpu.cameras.tones import match_tones
from lfgpu.data import LightField, Reading
from lfgpu.errors import LightFieldError
from lfgpu.io import write_hci, write_pfm
from lfgpu.io.contradictions import contradictions
from lfgpu.io.flips import flipped
from tests.made import thorough


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(96, 96), seed=3)


def test_nothing_stands_out_where_cameras_are_right() -> None:
    boxes = scenes.make("boxes", grid=(5, 5), size=(128, 128), seed=3)
    found = lfgpu.explain(boxes, truth(boxes))
    assert found.findings == ()
    assert found.signs is None
    assert found.misalignment < 0.01
    assert np.abs(found.brightness - 1).max() < 0.01
    assert found.psnr[boxes.reference_index] == np.inf
    assert found.mean_psnr > 29
    assert np.nanmedian(found.unexplained) < 0.02


def said_of(boxes: LightField, index: int, change: Callable[[np.ndarray], np.ndarray]) -> tuple[Explanation, str]:
    """What is found, and the one sentence, of the view that is changed."""
    found = explained(with_view(boxes, index, change))
    (sentence,) = found.findings
    row, column = divmod(index, 5)
    assert f"the view at row {row}, column {column} is" in sentence
    return found, sentence


@pytest.mark.parametrize(("index", "shift"), [(12, (-0.2, -0.2)), (20, (0.15, 0.15))])
def test_a_view_that_is_moved_is_named_with_its_direction(
    boxes: LightField, index: int, shift: tuple[float, float]
) -> None:
    """The reference view (12) among them: then it is not all others that are said to be moved."""
    found, sentence = said_of(boxes, index, lambda image: displaced(image, *shift))
    assert ("to the right" in sentence) == (shift[0] > 0)
    assert ("above" in sentence) == (shift[1] < 0)
    assert np.abs(found.shift[index] - shift).max() < 0.05
    others = np.delete(found.shift, index, axis=0)
    assert np.abs(others).max() < 0.05


@pytest.mark.parametrize(
    ("index", "shift"), [(20, (0, 45)), *(thorough(*case) for case in ((3, (2, 0)), (0, (-15, 9))))]
)
def test_a_view_that_is_far_off_is_found_where_it_is(boxes: LightField, index: int, shift: tuple[int, int]) -> None:
    """All its points are outliers there: steps from where it should be do not reach it. Half of the picture is far."""
    found, _ = said_of(boxes, index, lambda image: np.roll(image, shift, axis=(1, 0)))
    np.testing.assert_allclose(found.shift[index], shift, atol=0.05)
    assert np.abs(np.delete(found.shift, index, axis=0)).max() < 0.05
    assert found.misfit.max() < 0.1


def test_exchanged_views_are_told_apart(boxes: LightField) -> None:
    order = np.arange(25)
    order[[0, 2, 24]] = [2, 24, 0]
    result = lfgpu.estimate_depth(exchanged := replace(boxes, views=boxes.views[order]), config="fast")
    (sentence,) = result.remarks
    assert "row 0, column 0 shows what belongs at row 0, column 2; " in sentence
    assert sentence.endswith("row 4, column 4 shows what belongs at row 0, column 0: correct the names of the files.")
    found = lfgpu.explain(exchanged, result)
    assert found.place.tolist() == order.tolist()
    assert np.isnan(found.shift[[0, 2, 24]]).all()
    assert found.misalignment < 0.02


def test_of_exchanged_views_only_the_one_that_is_tried_has_another_misfit(
    boxes: LightField, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = np.arange(25)
    order[[0, 24]] = [24, 0]
    exchanged = replace(boxes, views=boxes.views[order])
    asked, unlike = [], consensus.unlike
    monkeypatch.setattr(consensus, "unlike", lambda misfit, offsets: asked.append(misfit) or unlike(misfit, offsets))
    found = lfgpu.explain(exchanged, truth(boxes))
    tried = [misfit != found.misfit for misfit in asked if (misfit != found.misfit).any()][-2:]
    assert [np.flatnonzero(changed).tolist() for changed in tried] == [[0], [24]]


@pytest.mark.parametrize(
    "change",
    [
        thorough(lambda image: 0 * image, id="black"),
        pytest.param(lambda image: image[::-1], id="upside down"),
        thorough(lambda image: 255 - image, id="negative"),
    ],
)
def test_a_view_that_fits_nowhere_is_named(boxes: LightField, change) -> None:
    wrong = with_view(boxes, 6, change)
    before = lfgpu.estimate_depth(wrong, config="fast", check_cameras=False)
    result = lfgpu.judged(wrong, before)
    (sentence,) = result.remarks
    assert sentence.startswith(
        "what is shown at row 1, column 1 fits the other views at no camera's place, moved or not: "
    )
    assert "replace pictures that are covered" in sentence
    assert "read the rest with --allow-missing (allow_missing=True in Python)." in sentence
    assert np.isnan(lfgpu.explain(wrong, result).brightness[6])
    np.testing.assert_array_equal(result.confidence, before.confidence)


@pytest.mark.parametrize("line", ["row", thorough("column")])
def test_cameras_of_a_line_along_the_other_axis_are_named(line: str) -> None:
    lf = scenes.make("boxes", grid=(9, 9), size=(96, 112), seed=2).subset(line)
    assert not [said for said in lfgpu.estimate_depth(lf, config="fast").remarks if "rows of cameras" in said]
    crossed = LightField(lf.views, lf.positions[:, ::-1])
    (sentence,) = lfgpu.estimate_depth(crossed, config="fast").remarks
    assert sentence == "rows of cameras are taken for columns: read it with --transpose."


def test_turned_and_bright_views_are_named(boxes: LightField) -> None:
    turned = with_view(boxes, 6, lambda image: displaced(image, degrees=0.2))
    found = lfgpu.explain(with_view(turned, 8, lambda image: 0.92 * image), truth(boxes))
    assert found.rotation[6] == pytest.approx(0.2, abs=0.03)
    np.testing.assert_allclose(found.gain[8], 0.92, atol=0.01)
    assert len(found.findings) == 2
    assert any("row 1, column 1" in sentence and "clockwise" in sentence for sentence in found.findings)
    assert any("row 1, column 3 is 8" in sentence and "darker" in sentence for sentence in found.findings)
    exposed = with_view(boxes, 8, lambda image: 0.5 * image)
    (sentence,) = lfgpu.explain(exposed, truth(exposed)).findings
    assert "row 1, column 3 is 50 % darker" in sentence


@pytest.mark.parametrize(
    ("matrix", "signs", "irregular"),
    [
        (((1, 0), (0, -1)), "v", False),
        thorough(((-1, 0), (0, -1)), "uv", True),
        thorough(((0, 1), (1, 0)), "transposed", False),
        (((0, 1), (-1, 0)), "turned", True),
    ],
)
def test_wrong_signs_are_found(
    boxes: LightField, matrix: tuple[tuple[int, int], tuple[int, int]], signs: str, irregular: bool
) -> None:
    lf = boxes
    if irregular:
        lf = lf.subset([0, 1, 3, 6, 9, 11, 12, 14, 15, 18, 20, 23])
    turned = replace(lf, positions=lf.positions @ np.array(matrix, float).T, grid_shape=None, truth=None, geometry=None)
    found = explained(turned)
    assert found.signs == signs
    assert len(found.findings) == 1


@pytest.mark.parametrize("flip", ["", thorough("u")])
def test_a_pair_tells_nothing_of_what_hides_what(flip: str) -> None:
    """What is hidden in the only other view has whatever disparity fits; both signs were said to be wrong."""
    pair = flipped(
        scenes.make("boxes", grid=(1, 2), size=(160, 200), disparity_range=(5, 30), seed=3, noise=0.01), flip
    )
    assert not near_and_far_swapped(pair, lfgpu.estimate_depth(pair, config="fast", check_cameras=False).disparity)


def test_a_reference_that_is_too_bright_tells_nothing_of_what_hides_what() -> None:
    lf = scenes.make("boxes", grid=(5, 5), size=(96, 120))
    lf.views[12] = (1.6 * lf.views[12].astype(float)).clip(0, 255)
    (sentence,) = lfgpu.estimate_depth(lf, config="fast").remarks
    assert "row 2, column 2 is 57 % brighter" in sentence


def test_options_that_were_given_are_counted_in(boxes: LightField) -> None:
    wrong = flipped(replace(boxes, truth=None, geometry=None, reading=Reading(flip="uv")), "uv")
    (sentence,) = explained(wrong).findings
    assert sentence.endswith("read it without --flip uv.")
    assert Reading(transpose=True, flip="u").advice(transpose=True, flip="v") == (
        "read it without --transpose --flip u"
    )
    assert Reading(flip="u").advice(transpose=True) == "read it with --transpose --flip v instead of --flip u"


def test_a_row_of_cameras_that_stood_in_a_column(boxes: LightField) -> None:
    column = boxes.subset("column")
    row = LightField(column.views, column.positions[:, ::-1])
    (sentence,) = lfgpu.explain(row, np.zeros(row.size, np.float32)).findings
    assert "at right angles to the line in which their cameras are said to stand: read it with --transpose." in sentence


@pytest.mark.parametrize(("name", "disparity_range"), [("boxes", (-0.5, 0.5)), ("relief", (-1.5, 1.5))])
def test_a_pair_that_is_out_of_line_is_not_taken_for_one_of_a_column(
    name: str, disparity_range: tuple[float, float]
) -> None:
    def sentence(grid: tuple[int, int], *, off: int) -> str:
        """Return what is said of a pair whose second picture stands `off` pixels too high."""
        views = scenes.make(name, grid=grid, size=(96, 128), disparity_range=disparity_range, seed=3).views
        pair = LightField(np.stack([views[0, : 96 - off], views[1, off:]]), [[0, 0], [1, 0]])
        against = contradictions(pair)
        (found,) = lfgpu.explain(pair, lfgpu.estimate_depth(pair, config="fast", check_cameras=False)).findings
        assert bool(against) == ("--transpose" in found)
        return found

    assert "out of line by 0.35 px" in sentence((1, 2), off=1)
    for off in (0, 1):
        assert "read it with --transpose." in sentence((2, 1), off=off)


@pytest.mark.parametrize("lower", [(0, 1, 2), (1, 0, 1, 2), thorough((0, 2, 1, 2, 3))])
@pytest.mark.parametrize(("name", "disparity_range"), [("boxes", (-0.5, 0.5)), thorough("relief", (-1.5, 1.5))])
def test_a_row_that_is_out_of_line_is_not_taken_for_a_column(
    name: str, disparity_range: tuple[float, float], lower: tuple[int, ...]
) -> None:
    views = scenes.make(name, grid=(1, len(lower)), size=(96, 128), disparity_range=disparity_range, seed=3).views
    shifted = np.stack([view[down : 93 + down] for view, down in zip(views, lower, strict=True)])
    lf = LightField(shifted, [[n, 0] for n in range(len(lower))])
    found = explained(lf)
    assert found.signs is None
    assert not any("taken for columns" in sentence for sentence in found.findings)
    assert contradictions(lf) == ()
    (taken_for_column,) = contradictions(replace(lf, positions=lf.positions[:, ::-1]))
    assert "at right angles to the line" in taken_for_column


def test_a_column_of_two_cameras_far_apart_is_told() -> None:
    views = scenes.make("relief", grid=(2, 1), size=(96, 128), disparity_range=(2, 8), seed=3).views
    pair = LightField(views, [[0, 0], [1, 0]])
    assert explained(pair).signs == "transposed"


def test_views_without_cameras_to_judge(boxes: LightField) -> None:
    same = LightField(np.repeat(boxes.views[:1], 5, axis=0), [[n, 0] for n in range(5)])
    result = lfgpu.estimate_depth(same, config="fast")
    assert "All views are the same picture" in result.notes[0]
    assert result.confidence.max() <= 0.1
    (sentence,) = lfgpu.explain(same, result).findings
    assert "there is no parallax" in sentence
    views = np.full((3, 3, 32, 32, 1), 100, np.uint8)
    lf = LightField.from_grid(views)
    found = lfgpu.explain(lf, np.zeros((32, 32), np.float32))
    assert np.isnan(found.shift).all()
    assert "only 0 points" in found.findings[0]
    wrong = np.ascontiguousarray(np.roll(truth(boxes), 45, axis=1)[::-1])
    (sentence,) = lfgpu.explain(boxes, wrong).findings
    assert "worse than a plane" in sentence


def test_the_order_of_depth_does_not_depend_on_how_bright_the_views_are(boxes: LightField) -> None:
    dark = boxes.views // 2
    dark[boxes.reference_index] = boxes.views[boxes.reference_index]
    bright, dim = (order_of_depth(lf, truth(boxes), views=8) for lf in (boxes, replace(boxes, views=dark)))
    assert bright.told == dim.told
    assert bright.near.sum() < 0.5 * bright.far.sum()
    np.testing.assert_allclose([dim.near.sum(), dim.far.sum()], [bright.near.sum(), bright.far.sum()], rtol=0.1)


def test_maps_are_weighed() -> None:
    """The map takes what is behind thin bars for what is in front: their points move otherwise."""
    lf = scenes.make("bars", grid=(5, 5), size=(160, 160), seed=3, noise=0.02)
    assert lfgpu.explain(lf, ndimage.grey_erosion(truth(lf), 9)).misalignment < 0.01
    # All that is told comes from one place, and there the other order of depth is far better.
    lf = scenes.make("relief", grid=(5, 5), size=(160, 160), seed=3)
    wrong = truth(lf).copy()
    wrong[70:94, 60:84] += 1.5
    order = order_of_depth(lf, wrong, views=8)
    assert order.told > 400
    assert order.far.sum() < 0.2 * order.near.sum()
    assert not near_and_far_swapped(lf, wrong)


def test_what_is_not_known_is_not_predicted(boxes: LightField) -> None:
    partial = truth(boxes).copy()
    partial[:, :48] = np.nan
    found = lfgpu.explain(boxes, partial)
    assert np.isnan(found.unexplained[:, :38]).all()
    assert found.predicted[0] < 0.65
    pictures = dict(residual_pictures(boxes, partial))
    assert len(pictures) == 24
    assert np.isnan(pictures[0]).mean() > 0.35


def test_maps_that_do_not_belong_are_refused(boxes: LightField) -> None:
    with pytest.raises(LightFieldError, match="must be 96 x 96"):
        lfgpu.explain(boxes, np.zeros((10, 10)))
    with pytest.raises(LightFieldError, match="undefined everywhere"):
        lfgpu.explain(boxes, np.full((96, 96), np.nan))
    other = lfgpu.DisparityMap(truth(boxes), position=(0.0, 0.0))
    with pytest.raises(LightFieldError, match="belongs to the view at row 0, column 0"):
        lfgpu.explain(boxes, other)


def offsets_of(reach: int) -> np.ndarray:
    """(u, v) of a grid of cameras, as far from its middle."""
    steps = np.arange(-reach, reach + 1.0)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def test_the_gauge_is_left_out_and_an_outlier_does_not_spoil_it() -> None:
    offsets = offsets_of(3)
    shifts = np.array([0.3, -0.2]) + 0.1 * offsets
    shifts[5] += (0.5, 0.0)
    rest = without_gauge(shifts, offsets)
    np.testing.assert_allclose(rest[5], (0.5, 0), atol=1e-3)
    np.testing.assert_allclose(np.delete(rest, 5, axis=0), 0, atol=1e-3)


def test_tones_are_found_despite_noise(rng: np.random.Generator) -> None:
    """A regression on the noisy reference itself would find gains that are too low."""
    like = rng.uniform(0.2, 0.6, 30_000)
    gain, offset = np.array([1.0, 0.8, 1.15, 1.0]), np.array([0.0, 0.02, -0.03, 0.0])
    radius2 = rng.uniform(0, 1, (4, 30_000))
    falloff = np.array([0.0, -0.2, 0.0, 0.1])
    shown = (gain[:, None] + falloff[:, None] * radius2) * like + offset[:, None] + rng.normal(0, 0.03, (4, 30_000))
    found = match_tones(shown, np.ones_like(shown), radius2, 0, vignetting=True)
    np.testing.assert_allclose(found[0], gain, atol=0.02)
    np.testing.assert_allclose(found[1], offset, atol=0.015)
    np.testing.assert_allclose(found[2], falloff, atol=0.02)


def test_check_on_the_command_line(boxes: LightField, tmp_path) -> None:
    moved = with_view(boxes, 3, lambda image: displaced(image, 0.3))
    write_hci(moved, tmp_path / "lf")
    write_pfm(tmp_path / "map.pfm", truth(boxes))
    result = command("check", tmp_path / "lf", tmp_path / "map.pfm")
    assert (result.code, "row 0, column 3" in result.out) == (0, True), result
    refused(command("check", tmp_path / "lf", tmp_path / "nothing.pfm"), "nothing.pfm")
    write_hci(boxes.crop(slice(9), slice(9)), tmp_path / "tiny")
    result = command("check", tmp_path / "tiny", "--disparity-range=-1,1")
    assert ("nothing can be" in result.out, "nan" in result.out) == (True, False), result


def test_check_does_not_measure_what_so_few_views_cannot_tell(tmp_path: Path) -> None:
    def shown() -> str:
        return " ".join(said("check", tmp_path, "--allow-missing").split())

    write_hci(scenes.make("boxes", grid=(2, 2), size=(96, 128), seed=3), tmp_path)
    of_four = shown()
    assert ("degrees rms" in of_four, "unknown" in of_four) == (True, False)
    (tmp_path / "input_Cam003.png").unlink()
    of_three = shown()
    assert "degrees rms" not in of_three
    assert "unknown rotations and scales: 3 views cannot tell them from another depth" in of_three
    (tmp_path / "input_Cam002.png").unlink()
    of_two = shown()
    assert "px rms across their line, standard error" in of_two
    assert "unknown shifts along their line, rotations and scales: 2 views cannot tell" in of_two


def test_noise_draws_no_view_between_its_pixels(rng: np.random.Generator) -> None:
    """On a plane all points of a view are looked up at the same fraction of a pixel: what noise does there adds up."""
    texture = 0.5 + 0.5 * ndimage.gaussian_filter(rng.normal(size=(128, 128)), 1.5)
    planes = [ndimage.shift(texture, (-0.3 * dv, -0.3 * du), order=5, mode="wrap") for du, dv in offsets_of(2)]
    views = np.stack(planes) + rng.normal(0, 0.03, (25, 128, 128))
    lf = LightField.from_grid(np.clip(views, 0, 1).astype(np.float32).reshape(5, 5, 128, 128, 1))
    found = lfgpu.explain(lf, np.full((128, 128), 0.3, np.float32))
    assert found.findings == ()
    assert found.misalignment < 0.025


def test_views_from_the_rim_are_held_against_each_other(rng: np.random.Generator) -> None:
    offsets = offsets_of(4)
    distance = np.hypot(*offsets.T)
    shifts = rng.normal(0, 0.01, (81, 2))
    errors = np.full((81, 2), 0.002)
    rim = shifts + 0.15 * (distance > 4.9)[:, None] * rng.choice([-1, 1], (81, 2))
    assert not outliers(rim, offsets, errors, least=0.1).any()
    for index in (0, 40, 44):
        moved = shifts.copy()
        moved[index] += (0.14, -0.14)
        assert np.flatnonzero(outliers(moved, offsets, errors, least=0.1)).tolist() == [index]
        unsure = np.where(np.arange(81)[:, None] == index, 0.1, errors)
        assert not outliers(moved, offsets, unsure, least=0.1).any()


def test_a_look_takes_all_views_as_far_from_the_reference() -> None:
    offsets = offsets_of(4)
    cross = np.flatnonzero((offsets == 0).any(axis=1))
    seen = seen_views(offsets, cross)
    more = {tuple(sorted(abs(offsets[n]))) for n in np.setdiff1d(seen, cross)}
    assert (len(seen), more) == (29, {(3, 4), (4, 4)})
    assert len(seen_views(offsets, range(40))) == 40
    assert len(seen_views(offsets[:9], [0, 1])) == 9
