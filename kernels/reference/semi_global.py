"""Semi-global matching: NumPy, float64, one direction after the other and of each one line of pixels at a time.

Hirschmüller, Stereo Processing by Semiglobal Matching and Mutual Information, PAMI 2008: a path to a pixel costs what
its pixels cost, and more where the disparity changes on the way. The least cost of a path is found from that to the
pixel before it; without the least of these, which is the same for all disparities, the numbers do not grow.
"""

import numpy as np

from lfgpu.contract import Float64Array as Array

LEAST_SMALL = 0.2  # what an edge in the image leaves of the cost of a change by one
LEAST_LARGE = 1.2  # of the cost of a larger change, relative to `small`


def path_costs(
    volume: Array, image: Array, scale: Array, dx: int, small: float, large: float, contrast: float
) -> Array:
    """Costs of the paths that go down a row and `dx` columns to the right with each pixel."""
    costs = volume.copy()
    width = volume.shape[2]
    here, there = slice(max(dx, 0), width + min(dx, 0)), slice(max(-dx, 0), width + min(-dx, 0))
    for y in range(1, volume.shape[1]):
        likeness = np.exp(-np.abs(image[y, here] - image[y - 1, there]).mean(1) / contrast)
        s = scale[y, here] * small * np.maximum(likeness, LEAST_SMALL)
        t = scale[y, here] * np.maximum(large * likeness, LEAST_LARGE * small)
        before = costs[:, y - 1, there]
        least = before.min(0)
        framed = np.pad(before, ((1, 1), (0, 0)), constant_values=np.inf)
        change = np.minimum(np.minimum(framed[:-2], framed[2:]) + s, least + t)
        costs[:, y, here] += np.minimum(before, change) - least
    return costs


def semi_global(
    volume: Array,
    image: Array,
    penalty_scale: Array,
    *,
    small: float,
    large: float,
    contrast: float,
    sum_out: Array,
) -> None:
    options = (small, large, contrast)
    sum_out[:] = 0
    for turn in (1, -1):
        for dx in (-1, 0, 1):
            sum_out[:, ::turn] += path_costs(volume[:, ::turn], image[::turn], penalty_scale[::turn], dx, *options)
        turned = volume.transpose(0, 2, 1), image.transpose(1, 0, 2), penalty_scale.T
        along = path_costs(turned[0][:, ::turn], turned[1][::turn], turned[2][::turn], 0, *options)
        sum_out[:, :, ::turn] += along.transpose(0, 2, 1)
