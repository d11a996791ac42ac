"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(max(cost, 1)), log evidence.
"""

SHARE = {"once": (1.795, 0.321, -1.019, 1.084), "twice": (1.886, 0.423, -0.768, 0.643)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-4.673, -0.51, 2.505, -1.525), "twice": (-4.785, -0.684, 1.614, -0.948)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
