"""A plane of one disparity, as tests of refocusing and of the viewer take it."""

import numpy as np

from lfgpu.data import LightField

SIZE = (24, 32)


def wall(disparity: float, *, valid: bool = False) -> LightField:
    """A plane of one disparity, drawn by hand: each view is the same texture, shifted."""
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float64)
    views = np.empty((3, 3, *SIZE, 1), np.float32)
    for v in range(3):
        for u in range(3):
            px, py = x + disparity * (u - 1), y + disparity * (v - 1)
            views[v, u, ..., 0] = 0.5 + 0.2 * np.sin(0.7 * px) + 0.2 * np.cos(0.9 * py)
    mask = np.ones((9, *SIZE), np.bool_)
    if valid:
        views[0, 0], mask[0] = 0, False
    return LightField.from_grid(views, valid=mask if valid else None)
