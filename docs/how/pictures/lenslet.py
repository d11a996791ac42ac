"""The capture of the tutorial on raw pictures, made by the code of that page; a decoded view; and its depth."""

import os
import re
import tempfile
from pathlib import Path

import imageio.v3 as iio
import matplotlib.pyplot as plt

import lfgpu

page = Path(os.environ["LFGPU_DOCS"], "tutorials", "lytro.md").read_text(encoding="utf-8")
code = re.search(r"```python\n(.*?)```", page, re.DOTALL)[1]
here = Path.cwd()
with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    try:
        exec(code, {})
        raw = iio.imread("capture.png")
        lf = lfgpu.read("capture.png")
    finally:
        os.chdir(here)
result = lfgpu.estimate_depth(lf)

figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
axes[0].imshow(raw[150:350, 150:350], cmap="gray", interpolation="nearest")
axes[0].set_title("a part of the raw capture")
axes[1].imshow(lf.image(lf.reference_index), interpolation="nearest")
axes[1].set_title("the middle view of 49")
axes[2].imshow(result.disparity, interpolation="nearest")
axes[2].set_title("disparity")
for axis in axes:
    axis.set_axis_off()
