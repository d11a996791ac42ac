"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, B_device, C_fence, D_plant, E_clutter, F_cloth,
G_corridor, H_far, I_dim, J_shelf, vinyl, cotton, kitchen, own boxes, own planes, own bars, own textureless, own
noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-3.216, -0.979, 1.265, -0.603, 0.685, 0.116), "again": (-3.174, -1.023, 1.295, -0.52, 0.816, 0.144)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `SweepConfig.kind`."""

SPREAD = {"once": (3.647, 1.344, -2.542, 0.916, -0.889, -0.176), "again": (3.478, 1.068, -2.822, 1.115, -1.007, -0.141)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `SweepConfig.kind`."""
