"""An epipolar plane image: a line of pixels through all views of a row. The slope of a line is its disparity."""

import matplotlib.pyplot as plt

from lfgpu import scenes

lf = scenes.make("boxes", grid=(1, 17), size=(96, 256), disparity_range=(-1.5, 1.5))
row = 48

figure, axes = plt.subplots(2, 1, figsize=(8, 4.4), layout="constrained", height_ratios=(96, 68))
axes[0].imshow(lf.image(lf.reference_index))
axes[0].axhline(row, color="red", lw=1)
axes[0].set_title("the middle view of a row of 17")
axes[1].imshow((lf.views[:, row] * lf.scale), aspect="auto", interpolation="nearest")
axes[1].set_title("the red line in all 17 views, one below the other")
axes[1].set_ylabel("view u")
for axis in axes:
    axis.set_xticks([])
    axis.set_yticks([])
