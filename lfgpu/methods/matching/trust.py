"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless, own noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-3.019, -1.217, 1.144, -0.496, 0.415, 0.067), "twice": (-3.854, -1.344, 1.053, -0.463, 0.561, 0.11)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (4.445, 1.877, -1.859, 1.024, -1.082, -0.15), "twice": (6.502, 2.012, -1.712, 1.318, -1.584, -0.193)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
