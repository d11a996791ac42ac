"""Where the confidence of matching is low, and where the error is large."""

import matplotlib.pyplot as plt
import numpy as np

import lfgpu
from lfgpu import scenes

lf = scenes.make("bars", grid=(7, 7), size=(144, 192), noise=0.01)
result = lfgpu.estimate_depth(lf)
error = np.abs(result.disparity - lf.truth.disparity)

figure, axes = plt.subplots(1, 4, figsize=(10, 2), layout="constrained")
panels = (
    (lf.image(lf.reference_index), "one view", {}),
    (result.disparity, "disparity", {"cmap": "viridis"}),
    (result.confidence, "confidence", {"cmap": "cividis", "vmin": 0, "vmax": 1}),
    (error, "error, px per view step", {"cmap": "magma", "vmin": 0, "vmax": 0.3}),
)
for axis, (values, title, options) in zip(axes, panels, strict=True):
    drawn = axis.imshow(values, **options)
    axis.set_title(title)
    axis.set_axis_off()
    if options:
        figure.colorbar(drawn, ax=axis)
