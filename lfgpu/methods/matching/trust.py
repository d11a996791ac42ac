"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on own boxes, own planes, own bars, own textureless, A_bust,
C_fence, E_clutter, G_corridor, H_far.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(max(cost, 1)), log evidence.
"""

SHARE = {"once": (2.302, 0.201, -2.399, 2.219), "twice": (0.857, 0.155, -1.512, 1.926)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-4.965, -0.492, 6.149, -2.086), "twice": (-3.212, -0.53, 3.367, -1.649)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
