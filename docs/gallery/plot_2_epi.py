"""
Epipolar plane images
=====================

A line of pixels through all views of a row, stacked: each point of the scene is a straight line, and the slope of the
line is its disparity. The estimated slope is drawn through one pixel.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("still_life", grid=(9, 9), size=(112, 160))
result = lfgpu.estimate_depth(lf)

x, y = 62, 80
row = [lf.index_of(4, column) for column in range(9)]
epi = lf.views[row, y] * lf.scale
d = result.disparity[y, x]

figure, axes = plt.subplots(2, 1, figsize=(7, 6.6), layout="constrained", height_ratios=(7, 2))
axes[0].imshow(lf.image(lf.reference_index))
axes[0].axhline(y, color="white", lw=0.8)
axes[0].plot(x, y, "c+", ms=14, mew=2)
axes[1].imshow(epi, aspect="auto", interpolation="nearest")
axes[1].plot([x - d * (column - 4) for column in (0, 8)], [0, 8], "c", lw=2)
axes[1].set_title(f"the white line in nine views; slope {d:.2f} px per view step")
for axis in axes:
    axis.set_axis_off()
