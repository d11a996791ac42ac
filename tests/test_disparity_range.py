"""The range of disparities that is found: that it holds the scene and little else, whatever the cameras and views."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import real_data
from scipy.ndimage import gaussian_filter

from lfgpu import estimate_depth, read, scenes
from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods import disparity_range
from tests.made import thorough

KERNELS = load("warp")


def find_disparity_range(lf: LightField) -> tuple[float, float]:
    """With the default backend on the CPU."""
    return disparity_range.find_disparity_range(lf, Device(KERNELS, "cpu"))


def spans(lf: LightField, *, missing: float = 0.0, times: float = 1.3, more: float = 0.3) -> None:
    """Check that the range that is found holds all but a share of the pixels, and is not much wider than the truth."""
    low, high = find_disparity_range(lf)
    truth = lf.truth.disparity[np.isfinite(lf.truth.disparity)]
    assert ((truth < low) | (truth > high)).mean() <= missing
    assert high - low <= times * np.ptp(truth) + more


@pytest.mark.parametrize("noise", [0.03, thorough(0.0)])
@pytest.mark.parametrize("name", scenes.NAMES)
def test_it_holds_the_scene(name: str, noise: float) -> None:
    spans(scenes.make(name, seed=7, grid=(5, 5), size=(128, 160), noise=noise), missing=0.002)


@pytest.mark.parametrize(
    "extent",
    [*((-3.0, 3.0), (14.2, 18.8), (-20.0, -17.0)), *map(thorough, ((0.5, 2.0), (-2.5, -1.0), (-6.0, 9.0)))],
    ids=str,
)
def test_it_holds_small_and_large_disparities_of_few_views(extent: tuple[float, float]) -> None:
    side, more = (96, 0.6) if max(map(abs, extent)) <= 3 else (192, 1.0)
    spans(scenes.make("relief", grid=(5, 5), size=(side, side), disparity_range=extent), more=more)


@pytest.mark.parametrize("grid", [(1, 9), (9, 1), (1, 17), (3, 3), (2, 2)], ids=str)
def test_it_holds_with_few_views_or_one_line_of_them(grid: tuple[int, int]) -> None:
    spans(scenes.make("relief", grid=grid, size=(128, 128)), more=0.7)


def test_views_of_different_brightness_and_a_plain_wall_do_not_open_it() -> None:
    lf = scenes.make("planes", grid=(5, 5), size=(160, 160), noise=0.0)
    assert lf.truth is not None
    dim = lf.views.astype(np.float32) / 255
    dim[:, :80] *= 0.02  # of whose texture noise leaves nothing
    noisy = dim + np.random.default_rng(0).normal(0, 0.01, dim.shape)
    spans(replace(lf, views=np.clip(noisy, 0, 1).astype(np.float32)), missing=0.002)
    lf = scenes.make("boxes", grid=(5, 5), size=(160, 160))
    gains = np.random.default_rng(0).normal(1, 0.05, len(lf.views)).astype(np.float32)
    uneven = replace(lf, views=np.clip(lf.views / np.float32(255) * gains[:, None, None, None], 0, 1))
    spans(uneven, missing=0.002)


def test_masked_pixels_have_no_say() -> None:
    lf = scenes.make("relief", grid=(5, 5), size=(128, 128))
    valid = np.ones(lf.views.shape[:3], bool)
    valid[:, :, :40] = False
    views = lf.views.copy()
    views[:, :, :40] = np.random.default_rng(0).integers(0, 255, (lf.size[0], 40, 3))  # at disparity 0, but masked
    away = scenes.make("relief", grid=(5, 5), size=(128, 128), disparity_range=(2.0, 3.0))
    masked = replace(away, views=np.where(valid[..., None], away.views, views), valid=valid)
    assert find_disparity_range(masked)[0] > 1.5
    assert find_disparity_range(replace(masked, valid=None))[0] < 0.5


def test_it_is_in_steps_of_the_cameras() -> None:
    lf = scenes.make("planes", grid=(5, 5), size=(128, 128), seed=2)
    low, high = find_disparity_range(lf)
    apart = replace(lf, positions=lf.positions * 4, grid_shape=None)
    np.testing.assert_allclose([4 * bound for bound in find_disparity_range(apart)], [low, high], rtol=1e-5)
    lf = scenes.make("relief", grid=(7, 7), size=(128, 128))
    spans(lf.subset([lf.index_of(k, k) for k in range(7)]), missing=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_views_without_texture_have_none(noise: float) -> None:
    plain = 0.5 + np.random.default_rng(0).normal(0, noise, (3, 3, 64, 64, 3))
    with pytest.raises(LightFieldError, match=r"wall: the disparity range cannot be found.*give disparity_range"):
        find_disparity_range(LightField.from_grid(np.clip(plain, 0, 1).astype(np.float32), name="wall"))


def test_a_reference_much_brighter_than_the_others_has_none_which_is_named_as_a_reason() -> None:
    lf = scenes.make("boxes", grid=(3, 3), size=(96, 128), seed=3)
    dim = (0.4 * lf.views).astype(np.uint8)
    dim[lf.reference_index] = lf.views[lf.reference_index]
    with pytest.raises(LightFieldError, match=r"cannot be found.*unequal brightness"):
        find_disparity_range(replace(lf, views=dim))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bars", {"seed": 9098, "grid": (3, 7), "size": (200, 360), "disparity_range": (-3.5, 3.5), "noise": 0.01}),
        thorough("bars", {"seed": 5002, "grid": (7, 7), "size": (160, 200), "noise": 0.043, "channels": 1}),
        thorough("bars", {"seed": 440, "grid": (11, 11), "size": (320, 288), "noise": 0.02, "channels": 1}),
    ],
    ids=["few", "noisy", "many"],
)
def test_a_wall_behind_noise_is_in_it(name: str, options: dict[str, Any]) -> None:
    """The whole background was lost: its texture is seen above the noise in views four times as small only."""
    reference = (0, 0) if options["grid"] == (3, 7) else (8, 0) if options["grid"] == (11, 11) else None
    spans(scenes.make(name, reference=reference, **options), missing=0.002)


@pytest.mark.parametrize("backend", ["reference", thorough("taichi")])
def test_it_does_not_depend_on_the_backend(backend: str) -> None:
    lf = scenes.make("boxes", grid=(3, 3), size=(64, 72))
    valid = np.random.default_rng(0).uniform(size=lf.views.shape[:3]) > 0.001
    for some in (lf, replace(lf, valid=valid)):
        found = disparity_range.find_disparity_range(some, Device(load(backend), "cpu"))
        np.testing.assert_allclose(found, find_disparity_range(some), atol=1e-4)


def test_it_does_not_depend_on_how_views_reach_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    lf = scenes.make("relief", grid=(5, 5), size=(64, 72))
    valid = np.random.default_rng(0).uniform(size=lf.views.shape[:3]) > 0.001
    for some in (lf, replace(lf, valid=valid)):
        found = find_disparity_range(some)
        views = KERNELS.image(some.views, "cpu")
        assert disparity_range.find_disparity_range(some, Device(KERNELS, "cpu"), views=views) == found
        with monkeypatch.context() as patch:
            patch.setattr(disparity_range, "_AT_ONCE", 2 * some.views[0].nbytes)
            assert find_disparity_range(some) == found


def test_what_two_views_say_by_chance_no_third_one_denies() -> None:
    """The map has 98 % of its pixels from -0.8 to 0.65."""
    low, high = find_disparity_range(read(real_data("real/corners")))
    assert -1.3 < low < -0.8
    assert 0.65 < high < 1.1


@pytest.mark.parametrize(
    "name", [*("population/C_fence", "cotton"), *map(thorough, ("population/A_bust", "population/E_clutter", "vinyl"))]
)
def test_it_holds_rendered_scenes(name: str) -> None:
    spans(read(real_data(name)), missing=0.002, more=0.0)


@pytest.mark.parametrize(("sigma", "step", "count", "side"), [(0, 1, 5, 200), thorough(0.7, 2, 3, 400)])
def test_texture_finer_than_the_pixels_of_reduced_views(sigma: float, step: int, count: int, side: int) -> None:
    """Speckle on a plane of whole disparity is matched perfectly at full resolution, and looks like noise reduced."""
    reach = side + step * count
    texture = np.random.default_rng(0).random((reach, reach, 3))
    texture = gaussian_filter(texture, (sigma, sigma, 0), mode="wrap") if sigma else texture
    texture = ((texture - texture.min()) / (texture.max() - texture.min()) * 255).astype(np.uint8)
    places = np.arange(count) * step
    lf = LightField.from_grid([[texture[v : v + side, u : u + side] for u in places] for v in places])
    low, high = find_disparity_range(lf)
    assert low < step < high
    result = estimate_depth(lf, config="fast", disparity_range=(step - 1.3, step + 1.3), device="cpu")
    assert np.median(result.confidence) > 0.3
    assert result.notes == ()
