"""The map of *Start*, beside the view that it belongs to."""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("boxes", grid=(5, 5), size=(144, 192))
result = lfgpu.estimate_depth(lf)

figure, axes = plt.subplots(1, 3, figsize=(10, 2.6), layout="constrained")
axes[0].imshow(lf.image(lf.reference_index))
axes[0].set_title("the middle view of 25")
drawn = axes[1].imshow(result.disparity, cmap="viridis")
axes[1].set_title("disparity, px per view step")
figure.colorbar(drawn, ax=axes[1])
drawn = axes[2].imshow(result.confidence, cmap="cividis", vmin=0, vmax=1)
axes[2].set_title("confidence")
figure.colorbar(drawn, ax=axes[2])
for axis in axes:
    axis.set_axis_off()
