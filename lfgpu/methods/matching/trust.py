"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(max(cost, 1)), log evidence.
"""

SHARE = {"once": (2.149, 0.216, -2.148, 1.975), "twice": (1.178, 0.134, -1.494, 1.818)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-4.575, -0.455, 4.012, -1.775), "twice": (-2.982, -0.578, 2.251, -1.82)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
