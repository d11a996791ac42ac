"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless, own noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-2.944, -1.181, 1.158, -0.495, 0.41, 0.067), "twice": (-3.767, -1.309, 1.086, -0.454, 0.555, 0.113)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (4.359, 1.833, -1.874, 1.024, -1.066, -0.15), "twice": (6.617, 2.08, -1.664, 1.321, -1.574, -0.189)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
