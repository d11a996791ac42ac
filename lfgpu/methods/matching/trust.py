"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, B_device, C_fence, D_plant, E_clutter, F_cloth,
G_corridor, H_far, I_dim, J_shelf, vinyl, cotton, kitchen, own boxes, own planes, own bars, own textureless, own
noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-3.056, -0.99, 1.282, -0.574, 0.674, 0.116), "again": (-3.002, -0.953, 1.316, -0.532, 0.798, 0.14)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `SweepConfig.kind`."""

SPREAD = {"once": (3.377, 1.338, -2.549, 0.874, -0.798, -0.162), "again": (3.118, 0.985, -2.774, 1.123, -0.918, -0.123)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `SweepConfig.kind`."""
