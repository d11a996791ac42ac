"""
Real captures
=============

Two captures of a Lytro of the first generation: a flower before bushes, and the neck of a guitar. The views come from
lenses of a tenth of a millimetre, so they are noisy; the confidence is low where the map is wrong. The light fields are
those of M. W. Tao, S. Hadap, J. Malik, R. Ramamoorthi, *Depth from Combining Defocus and Correspondence Using
Light-Field Cameras*, ICCV 2013. They are no part of lfgpu: this script draws them if `LFGPU_DATA` names the folder that
has them, and otherwise shows what it drew before.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lfgpu

DRAWN = Path("real_captures.webp")

if "LFGPU_DATA" in os.environ:
    figure, axes = plt.subplots(2, 3, figsize=(9, 7), layout="constrained")
    for row, name in zip(axes, ("tao2013_IMG_1", "tao2013_IMG_4"), strict=True):
        lf = lfgpu.read(Path(os.environ["LFGPU_DATA"]) / name)
        result = lfgpu.estimate_depth(lf)
        view = lf.image(lf.reference_index)
        row[0].imshow(np.clip(view / np.quantile(view, 0.995), 0, 1) ** (1 / 2.2))  # the views are linear and dark
        low, high = np.quantile(result.disparity, (0.02, 0.98))
        row[1].imshow(result.disparity, vmin=low, vmax=high)
        row[2].imshow(result.confidence, cmap="cividis", vmin=0, vmax=1)
    for axis, title in zip(axes[0], ("one view of 49", "disparity", "confidence"), strict=True):
        axis.set_title(title)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.savefig(DRAWN, dpi=110, pil_kwargs={"quality": 75})
else:
    figure, axis = plt.subplots(figsize=(9, 7), layout="constrained")
    axis.imshow(plt.imread(DRAWN))
    axis.set_axis_off()
