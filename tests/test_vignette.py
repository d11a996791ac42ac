"""Black corners: found where a lens left them, and nowhere else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lfgpu
from lfgpu import LightField, scenes
from lfgpu.io import write_hci
from lfgpu.io.brightness import without_black_corners

SIZE = 64


def round_views(lf: LightField, corners: str = "all") -> tuple[LightField, np.ndarray]:
    """The views as a round lens shows them, and where it shows nothing."""
    y, x = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    black = np.hypot(y, x) > 0.6 * SIZE
    if corners == "three":
        black &= (y < 0) | (x < 0)
    return replace(lf, views=np.where(black[..., None], np.uint8(2), lf.views)), black


@pytest.fixture(scope="module")
def scene() -> LightField:
    return scenes.make("relief", grid=(5, 5), size=(SIZE, SIZE))


def test_black_corners_are_left_out_and_said(scene: LightField) -> None:
    lf, black = round_views(scene)
    found = without_black_corners(lf)
    assert found.valid is not None
    assert not found.valid[:, black].any()
    assert found.valid.mean() > 0.95 * (1 - black.mean())
    assert found.valid[:, 20:-20, 20:-20].all()
    assert "corners are black" in found.notes[-1]


def ratio_beside_them(scene: LightField) -> float:
    """The mean error of the map beside black corners over that of the map of whole views; they are not trusted."""
    lf = without_black_corners(round_views(scene)[0])
    assert scene.truth is not None
    assert lf.valid is not None
    there = lf.valid[lf.reference_index]
    whole, left = (lfgpu.estimate_depth(each, disparity_range=(-1.6, 1.7)) for each in (scene, lf))
    assert (left.confidence[~there] == 0).all()
    errors = [np.abs(result.disparity - scene.truth.disparity)[there].mean() for result in (whole, left)]
    return float(errors[1] / errors[0])


def test_without_them_the_maps_of_six_scenes_are_right_in_the_mean() -> None:
    made = (scenes.make("relief", grid=(5, 5), size=(SIZE, SIZE), seed=seed) for seed in range(6))
    assert np.mean([ratio_beside_them(scene) for scene in made]) < 1.1


@pytest.mark.parametrize("what", ["nothing black", "three corners", "mask given", "one view not", "all black", "few"])
def test_everything_else_stays_as_it_is(scene: LightField, what: str) -> None:
    lf, _ = round_views(scene, "three" if what == "three corners" else "all")
    views = lf.views.copy()
    if what == "nothing black":
        lf = scene
    elif what == "mask given":
        lf = replace(lf, valid=np.ones(lf.views.shape[:3], bool))
    elif what == "one view not":
        views[3, 0, 0] = 90
        lf = replace(lf, views=views)
    elif what == "all black":
        lf = replace(lf, views=np.zeros_like(views))
    elif what == "few":
        views = np.maximum(scene.views, 9)
        views[:, :: SIZE - 1, :: SIZE - 1] = 0
        lf = replace(scene, views=np.tile(views, (1, 4, 4, 1))[:, : 4 * SIZE, : 4 * SIZE], truth=None)
        lf = replace(lf, views=np.maximum(lf.views, 9))
        lf.views[:, [0, 0, -1, -1], [0, -1, 0, -1]] = 0
    assert without_black_corners(lf) is lf


def test_reading_finds_them(scene: LightField, tmp_path: Path) -> None:
    write_hci(round_views(scene)[0], tmp_path / "round")
    lf = lfgpu.read(tmp_path / "round")
    assert lf.valid is not None
    assert any("corners are black" in note for note in lf.notes)
