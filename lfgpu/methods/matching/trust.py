"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(max(cost, 1)), log evidence.
"""

SHARE = {"once": (2.091, 0.192, -1.745, 1.741), "twice": (2.316, 0.108, -1.774, 1.803)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-4.97, -0.393, 2.924, -1.721), "twice": (-4.935, -0.394, 2.14, -1.856)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
