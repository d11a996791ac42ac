"""Planes through the pixels of a map, and the map made of the best of them; NumPy, float64.

Windows that hold an outline fit no plane. So a pixel beside an outline takes the plane of a window that lies on its own
side, and the surface goes straight on up to the outline.
"""

import numpy as np

from lfgpu.contract import FACET_REACH, Float64Array as Array

_PLACES = range(-FACET_REACH, FACET_REACH + 1)


def planes(map_: Array, *, planes_out: Array) -> None:
    height, width = map_.shape
    for y in range(height):
        for x in range(width):
            rows = np.arange(max(y - FACET_REACH, 0), min(y + FACET_REACH + 1, height))
            columns = np.arange(max(x - FACET_REACH, 0), min(x + FACET_REACH + 1, width))
            values = map_[np.ix_(rows, columns)]
            down, right = rows - rows.mean(), columns - columns.mean()
            # Over a rectangle the two slopes do not depend on each other; of one row or column there is no slope.
            by_y = (down @ values).mean() / (down @ down or 1)
            by_x = (values @ right).mean() / (right @ right or 1)
            rest = values - values.mean() - by_y * down[:, None] - by_x * right
            here = values.mean() + by_y * (y - rows.mean()) + by_x * (x - columns.mean())
            planes_out[y, x] = here, by_x, by_y, (rest**2).mean()


def facets(planes: Array, *, facets_out: Array) -> None:
    height, width = facets_out.shape
    y, x = np.indices((height, width))
    least = np.full((height, width), np.inf)
    for dy in _PLACES:
        for dx in _PLACES:
            row, column = np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)
            value, by_x, by_y, residual = np.moveaxis(planes[row, column], -1, 0)
            is_better = residual < least
            facets_out[is_better] = (value + by_x * (x - column) + by_y * (y - row))[is_better]
            least = np.minimum(least, residual)
