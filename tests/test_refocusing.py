"""Refocused and all-in-focus images of planes whose disparity is known."""

import numpy as np
import pytest
from walls import SIZE, wall

from lfgpu import scenes
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.viz.refocusing import all_in_focus, refocus


@pytest.mark.parametrize("disparity", [1.0, -2.0, 0.0])
@pytest.mark.parametrize("valid", [False, True])
def test_what_is_in_focus_looks_as_in_the_reference(disparity: float, valid: bool) -> None:
    lf = wall(disparity, valid=valid)
    sharp, blurred = refocus(lf, disparity), refocus(lf, disparity + 2)
    reference = lf.image(lf.reference_index)
    np.testing.assert_allclose(sharp, reference, atol=1e-5)
    np.testing.assert_allclose(refocus(lf, disparity, order=1), reference, atol=1e-5)
    assert np.abs(blurred - reference).mean() > 0.05


def test_focus_between_pixels_is_nearly_as_good() -> None:
    lf = wall(0.5)
    error = refocus(lf, 0.5) - lf.image(lf.reference_index)
    assert np.abs(error[2:-2, 2:-2]).max() < 0.05


@pytest.mark.parametrize("step", [2, 3])
@pytest.mark.parametrize("disparity", [-1.5, 0.0, 2.25])
def test_a_preview_is_every_few_pixels_of_the_whole(step: int, disparity: float) -> None:
    lf = wall(1.0)
    truth = DisparityMap(np.full(SIZE, 1.0, np.float32))
    for order in (1, 3):
        whole, sharp = refocus(lf, disparity, order=order), all_in_focus(lf, truth, order=order)
        np.testing.assert_allclose(refocus(lf, disparity, step=step, order=order), whole[::step, ::step], atol=1e-6)
        np.testing.assert_allclose(all_in_focus(lf, truth, step=step, order=order), sharp[::step, ::step], atol=1e-6)


def test_a_preview_of_few_views_has_the_reference_among_them() -> None:
    lf = wall(1.0)
    views = np.zeros_like(lf.views)
    views[lf.reference_index] = 0.9
    dark = LightField(views, lf.positions, reference=lf.reference_index)
    for most in (2, 3):
        assert refocus(dark, 0.0, most_views=most).min() >= 0.9 / most - 1e-6
    for options in ({"step": 0}, {"most_views": 1}, {"order": 2}):
        with pytest.raises(LightFieldError, match=next(iter(options))):
            refocus(lf, 0.0, **options)
        with pytest.raises(LightFieldError, match=next(iter(options))):
            all_in_focus(lf, DisparityMap(np.zeros(SIZE, np.float32)), **options)


def test_everywhere_in_focus_takes_noise_away_and_lets_no_occluder_through() -> None:
    clean = scenes.make("planes", grid=(5, 5), size=(48, 64))
    noisy = scenes.make("planes", grid=(5, 5), size=(48, 64), noise=0.02)
    assert clean.truth is not None
    truth, found = clean.image(clean.reference_index), all_in_focus(noisy, DisparityMap(clean.truth.disparity), order=1)
    before = np.sqrt(np.mean((noisy.image(noisy.reference_index) - truth) ** 2))
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.7 * before


def test_a_smaller_lens_takes_fewer_views() -> None:
    lf = wall(1.0)
    views = lf.views.copy()
    views[lf.index_of(0, 0)] = 1.0
    lf = LightField.from_grid(views.reshape(3, 3, *SIZE, 1))
    reference = lf.image(lf.reference_index)
    np.testing.assert_allclose(refocus(lf, 5.0, aperture=0.5), reference, atol=1e-5)
    np.testing.assert_allclose(refocus(lf, 1.0, aperture=1.0), reference, atol=1e-4)
    assert np.abs(refocus(lf, 1.0, aperture=1.5) - reference).mean() > 0.01
    with pytest.raises(LightFieldError, match="aperture"):
        refocus(lf, 1.0, aperture=-1)
