"""
A map and its error
===================

A view of the scene `still_life`, the estimated disparity, the exact truth, and their difference.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("still_life", grid=(7, 7), size=(144, 192))
result = lfgpu.estimate_depth(lf)
truth = lf.reference_truth().disparity
scores = lfgpu.evaluate(result.disparity, truth)

figure, axes = plt.subplots(2, 2, figsize=(8, 5.4), layout="constrained")
axes[0, 0].imshow(lf.image(lf.reference_index))
axes[0, 0].set_title(f"one view of {len(lf.views)}")
drawn = axes[0, 1].imshow(result.disparity, vmin=truth.min(), vmax=truth.max())
axes[0, 1].set_title("estimated disparity")
axes[1, 0].imshow(truth, vmin=truth.min(), vmax=truth.max())
axes[1, 0].set_title("truth")
error = axes[1, 1].imshow(result.disparity - truth, cmap="RdBu_r", vmin=-0.07, vmax=0.07)
axes[1, 1].set_title(f"error: BadPix(0.07) {scores.badpix_07:.1f} %")
figure.colorbar(drawn, ax=axes[0], label="px per view step")
figure.colorbar(error, ax=axes[1], label="px per view step")
for axis in axes.flat:
    axis.set_axis_off()
