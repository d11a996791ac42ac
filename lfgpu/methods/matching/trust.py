"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, B_device, C_fence, D_plant, E_clutter, F_cloth,
G_corridor, H_far, I_dim, J_shelf, vinyl, cotton, kitchen, own boxes, own planes, own bars, own textureless, own
noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-3.225, -0.974, 1.274, -0.604, 0.684, 0.116), "again": (-3.183, -1.021, 1.294, -0.521, 0.819, 0.145)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `SweepConfig.kind`."""

SPREAD = {"once": (3.582, 1.289, -2.587, 0.915, -0.903, -0.181), "again": (3.492, 1.032, -2.828, 1.119, -0.999, -0.144)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `SweepConfig.kind`."""
