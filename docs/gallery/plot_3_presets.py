"""
Three presets
=============

The same light field with three presets: thin rods before a far wall. The maps differ most along depth edges.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("bars", grid=(7, 7), size=(144, 192))
truth = lf.truth.disparity

figure, axes = plt.subplots(2, 4, figsize=(10, 4.6), layout="constrained")
axes[0, 0].imshow(lf.image(lf.reference_index))
axes[1, 0].imshow(truth, vmin=truth.min(), vmax=truth.max())
axes[1, 0].set_title("truth")
for column, preset in enumerate(("accurate", "fast", "paper"), 1):
    found = lfgpu.estimate_depth(lf, config=preset, disparity_range=(-1.6, 1.6)).disparity
    scores = lfgpu.evaluate(found, truth)
    axes[0, column].imshow(found, vmin=truth.min(), vmax=truth.max())
    axes[0, column].set_title(f"{preset}\nBadPix(0.07) {scores.badpix_07:.1f} %")
    error = axes[1, column].imshow(found - truth, cmap="RdBu_r", vmin=-0.07, vmax=0.07)
figure.colorbar(error, ax=axes[1], label="error, px per view step")
for axis in axes.flat:
    axis.set_axis_off()
