"""A range that is wider than the scene: it adds disparities that are compared, and moves none."""

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu.pipelines.estimate import estimate_depth


@pytest.mark.parametrize(
    ("config", "name"),
    [
        ("fast", "boxes"),
        ("fast", "planes"),
        ("fast", "textureless"),
        ("accurate", "boxes"),
        ("accurate", "planes"),
        ("accurate", "textureless"),
    ],
)
def test_a_range_that_is_wider_than_the_scene_changes_next_to_nothing(config: str, name: str) -> None:
    lf = scenes.make(name, grid=(5, 5), size=(96, 96))
    assert lf.truth is not None
    low, high = lf.truth.disparity.min() - 0.1, lf.truth.disparity.max() + 0.1
    narrow, wide = (
        estimate_depth(
            lf, disparity_range=(low - more, high + more), config=config, device="cpu", check_cameras=False
        ).disparity
        for more in (0.0, 0.07)
    )
    assert (np.abs(wide - narrow) > 0.02).mean() < 0.002
