"""Synthetic light fields with exact ground truth, rendered by ray casting.

`scenes.make("boxes", seed=3, grid=(7, 7))` is a `LightField` with exact `truth`. `scenes.NAMES` lists the scenes.
"""

from lfgpu.scenes.synthesis import NAMES, make, sequence, true_disparity, true_motion

__all__ = ["NAMES", "make", "sequence", "true_disparity", "true_motion"]
