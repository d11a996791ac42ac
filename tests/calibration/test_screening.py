"""The screening lets through what a look at the cameras would find, and stops where nothing is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from disturbed import truth, with_view
from scipy import ndimage

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import Misalignment, disturb
from lfgpu.cameras import points
from lfgpu.cameras.points import Points
from lfgpu.cameras.screening import worth_a_look
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.pipelines.verdict import judged


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(160, 176), seed=3, noise=0.004)


def turned(image: np.ndarray, degrees: float) -> np.ndarray:
    return ndimage.rotate(image, degrees, axes=(1, 0), reshape=False, order=3, mode="nearest")


@pytest.mark.parametrize("name", ["boxes", "planes", "relief", "bars"])
def test_right_cameras_need_no_look(name: str) -> None:
    lf = scenes.make(name, grid=(5, 5), size=(160, 176), seed=4)
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
        (3, lambda image: ndimage.shift(image, (0, 0.15, 0), order=3, mode="nearest")),
        (12, lambda image: ndimage.shift(image, (-0.15, 0, 0), order=3, mode="nearest")),
        (20, lambda image: turned(image, 0.15)),
        (7, lambda image: 0.95 * image),
    ],
)
def test_a_single_view_is_worth_it(boxes: LightField, index: int, change) -> None:
    """The reference view, 12, among them."""
    assert worth_a_look(with_view(boxes, index, change), truth(boxes))


@pytest.mark.parametrize("how", ["shift=0.15", "roll=0.2", "scale=0.003", "gain=0.05"])
def test_all_cameras_together_are_worth_it(boxes: LightField, how: str) -> None:
    assert worth_a_look(disturb(boxes, Misalignment.parse(how), seed=1).light_field, truth(boxes))


@pytest.mark.parametrize("preset", ["fast", pytest.param("accurate", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("matrix", [((1, 0), (0, -1)), ((-1, 0), (0, -1)), ((0, 1), (1, 0))])
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
    result = lfgpu.estimate_depth(boxes, config="fast", disparity_range=(-2, 2), device="cpu", check_cameras=False)
    assert isinstance(result, DepthResult)
    assert judged(boxes, result, device="cpu").remarks == ()
    assert not looks
    moved = with_view(boxes, 3, lambda image: np.roll(image, 1, axis=1))
    judged(moved, result, device="cpu")
    assert len(looks) == 1


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
