"""Weights of what the confidence and the uncertainty of matching are made of.

Written by `python -m benchmarks confidence --fit`, on A_bust, B_device, C_fence, D_plant, E_clutter, F_cloth,
G_corridor, H_far, I_dim, J_shelf, vinyl, cotton, kitchen, own boxes, own planes, own bars, own textureless, own
noise.
`MatchingPlan._judge` says what the weights belong to: 1, conflict, evidence, bend, relief, bend times relief.
"""

SHARE = {"once": (-4.484, -1.513, 0.889, -0.557, 0.662, 0.104), "again": (-3.786, -1.272, 0.993, -0.476, 0.779, 0.132)}
"""Of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `SweepConfig.kind`."""

SPREAD = {"once": (6.21, 2.459, -1.743, 0.883, -0.92, -0.169), "again": (5.249, 2.08, -1.68, 1.059, -0.95, -0.112)}
"""Of the logarithm of the variance of the disparity, (pixels per view step)², by `SweepConfig.kind`."""
