"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(max(cost, 1)), log evidence.
"""

SHARE = {"once": (2.091, 0.192, -1.745, 1.741), "twice": (2.049, 0.067, -1.874, 2.225)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-4.97, -0.393, 2.924, -1.721), "twice": (-4.715, -0.344, 2.255, -2.228)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
