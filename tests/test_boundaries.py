"""The two passes over depth edges: an outline that is blurred over two pixels is decided for both."""

import numpy as np
import pytest

from lfgpu._backends import open_device
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.completion import Boundaries
from lfgpu.methods.matching.config import MatchingConfig


@pytest.mark.parametrize(("share", "goes"), [(0.2, True), (0.4, False)])
def test_the_second_pixel_of_a_blurred_outline_goes_only_if_that_is_clear(share: float, goes: bool) -> None:
    """A black wall behind a white one that was matched two pixels too wide: column 3 shows nothing of it."""
    light = np.zeros((9, 10, 1), np.float32)
    light[:, 5:], light[:, 4] = 1.0, share
    matched = np.where(np.arange(10) >= 3, 1.0, -1.0) * np.ones((9, 1))
    device = open_device("warp", "cpu")
    out = device.zeros((9, 10))
    boundaries = Boundaries(Arena(device), MatchingConfig(), (9, 10), step=0.5)
    boundaries.run(device.image(np.sqrt(light)), device.field(matched), out)
    want = np.where(np.arange(10) >= (5 if goes else 4), 1.0, -1.0) * np.ones((9, 1))
    np.testing.assert_allclose(device.kernels.numpy(out), want, atol=1e-6)
