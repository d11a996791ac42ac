"""The map of synthesis after each stage."""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("planes", grid=(7, 7), size=(112, 144), noise=0.02)
result = lfgpu.estimate_depth(lf, config="paper", disparity_range=(-1.6, 1.6))
truth = lf.truth.disparity
panels = {
    "one view": lf.image(lf.reference_index),
    "1 local estimate": result.stages["local"],
    "2 propagation": result.stages["propagate"],
    "3 refinement": result.stages["refine"],
    "truth": truth,
}

figure, axes = plt.subplots(1, len(panels), figsize=(9.5, 1.8), layout="constrained")
for axis, (title, values) in zip(axes, panels.items(), strict=True):
    axis.imshow(values, cmap="viridis", vmin=truth.min(), vmax=truth.max())
    axis.set_facecolor("0.7")
    axis.set_title(title)
    axis.set_xticks([])
    axis.set_yticks([])
