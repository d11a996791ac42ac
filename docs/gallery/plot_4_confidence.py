"""
Which pixels to trust
=====================

The confidence of each pixel, and the sparsification curve: the share of bad pixels that is left when the least
confident ones are taken away, beside the smallest share that is possible.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes
from lfgpu.metrics import sparsification

lf = scenes.make("bars", grid=(7, 7), size=(144, 192), noise=0.01)
result = lfgpu.estimate_depth(lf, config="fast")
curve = sparsification(result, result.confidence, lf.truth)

figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
drawn = axes[0].imshow(result.confidence, cmap="cividis", vmin=0, vmax=1)
axes[0].set_axis_off()
figure.colorbar(drawn, ax=axes[0], label="confidence")
axes[1].plot(curve.kept, curve.bad, label="sorted by confidence")
axes[1].plot(curve.kept, curve.oracle, "--", label="sorted by the true error")
axes[1].invert_xaxis()
axes[1].set_xlabel("share of the pixels that are kept, %")
axes[1].set_ylabel("bad pixels among them, %")
axes[1].legend()
