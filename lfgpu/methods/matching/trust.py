"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(max(cost, 1)), log evidence.
"""

SHARE = {"once": (1.359, 0.578, -1.632, 1.047), "twice": (2.316, 0.108, -1.774, 1.803)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-4.3, -0.6, 3.325, -1.538), "twice": (-4.935, -0.394, 2.14, -1.856)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""

MOST_ODDS = {"once": 1.0, "twice": 1000.0}
MOST_COST = {"once": 4.0, "twice": 1000.0}
"""Larger odds and costs (units of the noise) say no more than these, by `sweep.occlusions`."""
