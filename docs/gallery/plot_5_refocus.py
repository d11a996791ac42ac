"""
Refocusing
==========

The views, shifted and averaged, make a picture with a shallow depth of field: sharp at one disparity. With the map, all
of it can be sharp.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("still_life", grid=(9, 9), size=(144, 192), noise=0.03)
result = lfgpu.estimate_depth(lf)
pictures = {
    "one view, noisy": lf.image(lf.reference_index),
    "sharp at -1.2, far": lfgpu.refocus(lf, -1.2),
    "sharp at 1.2, near": lfgpu.refocus(lf, 1.2),
    "all in focus": lfgpu.all_in_focus(lf, result),
}

figure, axes = plt.subplots(2, 2, figsize=(8, 6.4), layout="constrained")
for axis, (title, picture) in zip(axes.flat, pictures.items(), strict=True):
    axis.imshow(picture)
    axis.set_title(title)
    axis.set_axis_off()
