"""Reasons to doubt a pixel: each one alone, on a scene and a map where it is known where it applies."""

from dataclasses import replace

import numpy as np
import pytest

from lfgpu import DepthResult, LightField, Reason, estimate_depth, reasons, scenes

SIZE, RANGE = (64, 96), (-1.6, 1.6)


@pytest.fixture(scope="module")
def scene() -> LightField:
    return scenes.make("bars", grid=(5, 5), size=SIZE)


@pytest.fixture(scope="module")
def true(scene: LightField) -> DepthResult:
    """A result whose map is the truth."""
    result = estimate_depth(scene, config="fast", disparity_range=RANGE, check_cameras=False)
    assert scene.truth is not None
    return replace(result, disparity=scene.truth.disparity)


def where(reason: Reason, lf: LightField, result: DepthResult) -> np.ndarray:
    return reasons(lf, result) & reason > 0


def test_a_true_map_of_a_textured_scene_is_rarely_doubted(scene: LightField, true: DepthResult) -> None:
    found = reasons(scene, true)
    assert found.dtype == np.uint8
    for reason in Reason:
        share = np.mean(found & reason > 0)
        assert share < 0.15, (reason, share)


def test_plain_surfaces_have_no_texture(scene: LightField, true: DepthResult) -> None:
    """Also along one direction only, where the cameras stand in a row."""
    plain = scene.views.copy()
    plain[:, 20:40, 30:70] = 128
    found = where(Reason.NO_TEXTURE, replace(scene, views=plain), true)
    assert found[25:35, 35:65].all()
    assert found[:14].mean() < 0.2
    stripes = np.broadcast_to(np.where(np.arange(SIZE[0]) % 8 < 4, 60, 190)[None, :, None, None], scene.views.shape)
    striped = replace(scene, views=np.ascontiguousarray(stripes, np.uint8))
    row = striped.subset(np.flatnonzero(striped.offsets[:, 1] == 0))
    column = striped.subset(np.flatnonzero(striped.offsets[:, 0] == 0))
    assert where(Reason.NO_TEXTURE, row, true).all()
    assert not where(Reason.NO_TEXTURE, column, true).any()


def test_hidden_pixels_are_those_beside_a_nearer_surface(scene: LightField, true: DepthResult) -> None:
    disparity = np.full(SIZE, -1, np.float32)
    disparity[:, 40:50] = 1.5
    result = replace(true, disparity=disparity)
    right = scene.subset(np.flatnonzero((scene.offsets[:, 0] >= 0) & (scene.offsets[:, 1] == 0)))
    found = where(Reason.HIDDEN, right, result)[:, 10:-10]
    # The view beside the reference hides two and a half columns, the one behind it five: fewer than half see the first.
    assert found[:, 38 - 10 : 40 - 10].all()
    assert not found[:, : 37 - 10].any()
    assert not found[:, 40 - 10 :].any()
    assert not where(Reason.HIDDEN, right, replace(true, disparity=np.zeros(SIZE, np.float32)))[:, :-10].any()


def test_surfaces_beyond_the_range_are_at_its_end(scene: LightField, true: DepthResult) -> None:
    assert scene.truth is not None
    low = float(np.median(scene.truth.disparity))
    cut = replace(true, disparity=scene.truth.disparity.clip(low), disparity_range=(low, RANGE[1]))
    np.testing.assert_array_equal(where(Reason.END_OF_RANGE, scene, cut)[scene.truth.disparity <= low], True)
    assert not where(Reason.END_OF_RANGE, scene, true).any()


def test_what_views_do_not_show_is_unexplained(scene: LightField, true: DepthResult) -> None:
    """A glint that only the reference shows."""
    glint = scene.views.copy()
    glint[scene.reference_index, 20:30, 40:50] = 255
    found = where(Reason.UNEXPLAINED, replace(scene, views=glint), true)
    assert found[21:29, 41:49].mean() > 0.8
    assert found[40:].mean() < 0.1


def test_masked_pixels_have_no_reason_and_bad_cameras_are_one_everywhere(scene: LightField, true: DepthResult) -> None:
    disparity = true.disparity.copy()
    disparity[:10] = np.nan
    found = reasons(scene, replace(true, disparity=disparity, remarks=("views are shifted.",)))
    assert not found[:10].any()
    assert (found[10:] & Reason.CAMERAS > 0).all()
