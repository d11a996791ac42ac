"""
A view between the cameras
==========================

Every second row and column of views is left out. One of the views that were left out is rendered from the others and
their maps, and compared with the recorded view.
"""

import matplotlib.pyplot as plt
import numpy as np

import lfgpu
from lfgpu import scenes
from lfgpu.methods import preset

lf = scenes.make("still_life", grid=(7, 7), size=(112, 144))
kept = [lf.index_of(row, column) for row in (0, 2, 4, 6) for column in (0, 2, 4, 6)]
some = lfgpu.LightField(lf.views[kept], lf.positions[kept], name="every second view")

config = preset("accurate").with_values({"boundaries.contrast": 10})  # mixed pixels look best with the nearer side
maps = lfgpu.estimate_all_views(some, config=config, disparity_range=(-1.6, 1.6))
rendered = lfgpu.render_view(some, maps, 3, 3).image
recorded = lf.image(lf.index_of(3, 3))
psnr = -10 * np.log10(np.mean((rendered - recorded) ** 2))

figure, axes = plt.subplots(2, 2, figsize=(8, 5.8), layout="constrained")
axes[0, 0].imshow(lf.image(lf.index_of(2, 2)))
axes[0, 0].set_title("nearest view that was used")
axes[0, 1].imshow(rendered)
axes[0, 1].set_title("rendered view")
axes[1, 0].imshow(recorded)
axes[1, 0].set_title("recorded view")
difference = axes[1, 1].imshow(np.abs(rendered - recorded).mean(2), cmap="magma", vmax=0.2)
axes[1, 1].set_title(f"difference, {psnr:.1f} dB")
figure.colorbar(difference, ax=axes[1], label="intensity")
for axis in axes.flat:
    axis.set_axis_off()
