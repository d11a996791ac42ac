"""Costs at a pixel beside a depth edge: over all views, and over those on one side of the reference."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import map_coordinates

from lfgpu import scenes

lf = scenes.make("boxes", grid=(7, 7), size=(144, 192))
views, truth = lf.views * lf.scale, lf.truth.disparity

disparities = np.linspace(-1.6, 1.6, 129)
right, left = lf.offsets[:, 0] > 0, lf.offsets[:, 0] < 0


def costs_at(y, x):
    """How much each view differs from the reference at each disparity, [n, l]."""
    costs = np.empty((len(views), len(disparities)))
    for n, (du, dv) in enumerate(lf.offsets):
        at = [y - disparities * dv, x - disparities * du]
        seen = np.stack([map_coordinates(views[n, ..., c], at, order=1) for c in range(3)], axis=1)
        costs[n] = np.minimum(np.abs(seen - views[lf.reference_index, y, x]).mean(1), 0.1)
    return costs


def gain(y, x):
    """By how much the views on the right agree better than all views at the truth."""
    costs = costs_at(y, x)[:, np.argmin(np.abs(disparities - truth[y, x]))]
    return costs.mean() - costs[right].mean()


# Of some pixels that have something nearer to their left, the one at which partial view sets matter the most.
jump = np.roll(truth, 2, axis=1) - truth
candidates = np.argwhere(jump[20:-20, 20:-20] > 1)[::7] + 20
y, x = max(candidates, key=lambda place: gain(*place))
costs = costs_at(y, x)

figure, axes = plt.subplots(1, 2, figsize=(10, 2.9), layout="constrained", width_ratios=(1, 1.6))
axes[0].imshow(lf.image(lf.reference_index))
axes[0].plot(x, y, "o", mfc="none", mec="red", ms=14, mew=2.5)
axes[0].set_axis_off()
axes[1].plot(disparities, costs.mean(0), label="all views")
axes[1].plot(disparities, costs[right].mean(0), label="views on the right")
axes[1].plot(disparities, costs[left].mean(0), label="views on the left")
axes[1].axvline(truth[y, x], color="0.5", ls="--", label="truth")
axes[1].set_xlabel("disparity, px per view step")
axes[1].set_ylabel("mean cost")
axes[1].legend()
