"""Weights of the confidence and of the uncertainty of matching.

Written by `python -m benchmarks confidence --fit`, on A_bust, B_device, C_fence, D_plant, E_clutter, F_cloth,
G_corridor, H_far, I_dim, J_shelf, vinyl, cotton, kitchen, own boxes, own planes, own bars, own textureless, own
noise.
They belong to 1, conflict, evidence, bend, relief and bend times relief, see `Judging.run`.
"""

SHARE = {"once": (-3.085, -1.093, 1.25, -0.482, 0.694, 0.122), "again": (-2.784, -0.935, 1.208, -0.514, 0.776, 0.138)}
"""Weights of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `judging.kind_of`."""

SPREAD = {"once": (2.749, 1.011, -2.732, 0.967, -0.982, -0.169), "again": (2.64, 0.947, -2.701, 1.019, -1.029, -0.164)}
"""Weights of the logarithm of the variance of the disparity, (pixels per view step)², by `judging.kind_of`."""
