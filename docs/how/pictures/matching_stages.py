"""The map of matching after each stage, and its error."""

import matplotlib.pyplot as plt
import numpy as np

import lfgpu
from lfgpu import scenes
from lfgpu.methods.matching.method import Matching

lf = scenes.make("boxes", grid=(7, 7), size=(144, 192))
result = lfgpu.estimate_depth(lf, disparity_range=(-1.6, 1.6))
truth = lf.truth.disparity

figure, axes = plt.subplots(2, 4, figsize=(9, 3.6), layout="constrained")
for column, stage in enumerate(Matching.STAGES):
    found = result.stages[stage.name]
    drawn = axes[0, column].imshow(found, cmap="viridis", vmin=truth.min(), vmax=truth.max())
    bad = 100 * np.mean(np.abs(found - truth)[15:-15, 15:-15] > 0.07)
    axes[0, column].set_title(f"{column + 1} {stage.label}\nBadPix(0.07) {bad:.1f} %")
    wrong = axes[1, column].imshow(found - truth, cmap="RdBu_r", vmin=-0.2, vmax=0.2)
figure.colorbar(drawn, ax=axes[0], label="disparity")
figure.colorbar(wrong, ax=axes[1], label="error, px")
for axis in axes.flat:
    axis.set_axis_off()
