"""Synthetic light fields with exact ground truth, cast ray by ray: nothing is splatted, warped or interpolated.

`scenes.make("boxes", seed=3, grid=(7, 7))` is a `LightField` whose `truth` is exact; `scenes.NAMES` are the scenes.
"""

from lfgpu.scenes.synthesis import NAMES, make, sequence, true_disparity, true_motion

__all__ = ["NAMES", "make", "sequence", "true_disparity", "true_motion"]
