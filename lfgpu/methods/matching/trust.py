"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, B_device, C_fence, D_plant, E_clutter, F_cloth,
G_corridor, H_far, I_dim, J_shelf, vinyl, cotton, kitchen, own boxes, own planes, own bars, own textureless, own
noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-3.552, -1.289, 1.089, -0.547, 0.762, 0.116), "again": (-3.811, -1.255, 1.021, -0.482, 0.798, 0.137)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `SweepConfig.kind`."""

SPREAD = {"once": (4.481, 2.012, -1.815, 0.944, -0.978, -0.151), "again": (5.348, 2.097, -1.711, 1.073, -0.994, -0.116)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `SweepConfig.kind`."""
