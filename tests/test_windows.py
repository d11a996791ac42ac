"""Filters over windows are those of SciPy."""

import numpy as np
import pytest
from scipy import ndimage

from lfgpu.data.windows import eroded, gradient_size, smoothed, window_max, window_mean, window_min


@pytest.mark.parametrize("size", [1, 3, 7])
@pytest.mark.parametrize("shape", [(20, 30), (9, 7)])
def test_windows_are_those_of_scipy(shape: tuple[int, int], size: int) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    np.testing.assert_array_equal(window_max(values, size), ndimage.maximum_filter(values, size, mode="nearest"))
    np.testing.assert_array_equal(window_min(values, size), ndimage.minimum_filter(values, size, mode="nearest"))
    np.testing.assert_allclose(window_mean(values, size), ndimage.uniform_filter(values, size), rtol=1e-6)
    high = values > 0.9
    np.testing.assert_array_equal(window_max(high, size), ndimage.maximum_filter(high, size, mode="nearest"))
    np.testing.assert_array_equal(window_min(~high, size), ndimage.minimum_filter(~high, size, mode="nearest"))


@pytest.mark.parametrize("shape", [(20, 30), (9, 7)])
def test_smoothed_images_gradients_and_margins_are_those_of_scipy(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    for deviation in (0.7, 1.5):
        np.testing.assert_allclose(smoothed(values, deviation), ndimage.gaussian_filter(values, deviation), rtol=1e-5)
    sobel = np.hypot(ndimage.sobel(values, 0), ndimage.sobel(values, 1)) / 8
    np.testing.assert_allclose(gradient_size(values), sobel, rtol=0, atol=1e-6)
    known = values > 0.05
    for times in (1, 3):
        want = ndimage.binary_erosion(known, iterations=times, border_value=0)
        np.testing.assert_array_equal(eroded(known, times), want)
