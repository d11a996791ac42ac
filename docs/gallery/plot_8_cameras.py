"""
Cameras that are not where they should be
=========================================

The cameras of a rig are shifted at random. `lfgpu.explain` measures the shift of each from the views alone; here it is
drawn as an arrow, enlarged.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes
from lfgpu.calibration import Misalignment, disturb

lf = scenes.make("planes", grid=(5, 5), size=(128, 160))
found = disturb(lf, Misalignment(shift=0.5), seed=1)
rig = found.light_field
explanation = lfgpu.explain(rig, lfgpu.estimate_depth(rig, config="fast"))

u, v = rig.positions.T
figure, axis = plt.subplots(figsize=(5, 4.6), layout="constrained")
axis.quiver(u, v, *explanation.shift.T, angles="xy", scale_units="xy", scale=1.5, color="C1", label="measured")
axis.plot(u, v, "o", color="0.5", ms=4)
axis.set(xlabel="column", ylabel="row", title="measured shifts of the views, 1.5 px a step")
axis.margins(0.2)
axis.invert_yaxis()
axis.set_aspect("equal")
