"""The alignment of matching: pixels that it moves too far are put back."""

import numpy as np

from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.contract import Device
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.estimate import estimate_depth

STEP = MatchingConfig().sweep.step / 2  # pixels per view step between disparities, in a grid of 5 x 5 views


def test_what_the_alignment_moved_too_far_is_put_back() -> None:
    """With a reach of 0.4 px: pixels that moved less stay where they are, all others return."""
    lf, kernels = scenes.make("boxes", grid=(5, 5), size=(48, 48)), load("warp")
    config = MatchingConfig().with_tuning({"alignment.reach": 0.4 / STEP})
    matching = MatchingPlan(lf.layout, Measured((-1.0, 1.0), 0.004, None), config, Device(kernels, "cpu"))
    moved = np.linspace(-0.8, 0.8, 48 * 48, dtype=np.float32).reshape(48, 48)
    map_ = kernels.field(0.1 + moved, "cpu")
    matching._alignment.put_back(kernels.field(np.full((48, 48), 0.1), "cpu"), map_)
    want = np.where(np.abs(moved) < 0.4, 0.1 + moved, 0.1)
    np.testing.assert_allclose(kernels.numpy(map_), want, atol=1e-6)


def test_a_pixel_that_the_alignment_may_not_move_stays_near_where_it_was_matched() -> None:
    """With a reach of next to nothing, all that is left of the alignment is the plane through similar pixels."""
    lf = scenes.make("boxes", grid=(5, 5), size=(96, 96))
    far, near = (
        estimate_depth(
            lf,
            disparity_range=(-1.6, 1.6),
            config=MatchingConfig().with_tuning({"alignment.reach": reach}),
            device="cpu",
            check_cameras=False,
        ).stages
        for reach in (1000.0, 0.1)
    )
    np.testing.assert_array_equal(far["resweep"], near["resweep"])
    moved = [np.abs(stages["align"] - stages["resweep"]).mean() for stages in (far, near)]
    assert moved[1] < 0.8 * moved[0]
