"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, C_fence, E_clutter, G_corridor, H_far, own boxes, own
planes, own bars, own textureless, own noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-2.855, -1.177, 1.146, -0.496, 0.384, 0.058), "twice": (-3.78, -1.35, 1.081, -0.455, 0.551, 0.109)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `sweep.occlusions`."""

SPREAD = {"once": (4.239, 1.829, -1.892, 1.017, -1.029, -0.14), "twice": (6.479, 1.948, -1.744, 1.358, -1.626, -0.196)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `sweep.occlusions`."""
