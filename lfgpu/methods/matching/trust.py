"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless, own noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-2.976, -1.194, 1.159, -0.496, 0.414, 0.068), "twice": (-3.778, -1.309, 1.089, -0.455, 0.563, 0.114)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (4.419, 1.861, -1.868, 1.028, -1.08, -0.15), "twice": (6.636, 2.085, -1.664, 1.32, -1.578, -0.19)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
