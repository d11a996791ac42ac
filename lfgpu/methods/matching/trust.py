"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on own boxes, own planes, own bars, own textureless, A_bust,
C_fence, E_clutter, G_corridor, H_far.
`MatchingPlan._judge` says what the weights belong to: 1, -log odds, log(cost + 0.5), log evidence.
"""

SHARE = {"once": (2.489, 0.257, -1.668, 2.243), "twice": (1.081, 0.19, -1.349, 1.96)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (-6.03, -0.514, 5.08, -2.238), "twice": (-3.776, -0.563, 2.995, -1.663)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
