"""Light fields one view of which is not as it should be."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage

import lfgpu
from lfgpu.data import LightField


def truth(lf: LightField) -> np.ndarray:
    """The true disparity of the reference view, [y, x]."""
    return lf.truth.disparity


def explained(lf: LightField) -> lfgpu.Explanation:
    """What is said of the cameras by their own map, at which nobody has looked before."""
    return lfgpu.explain(lf, lfgpu.estimate_depth(lf, config="fast", check_cameras=False))


def with_view(lf: LightField, index: int, change: Callable[[np.ndarray], np.ndarray]) -> LightField:
    """With what `change` makes of one view, float64 [y, x, c] in stored units."""
    views = lf.views.copy()
    views[index] = np.clip(np.rint(change(views[index].astype(np.float64))), 0, 255)
    return replace(lf, views=views)


def displaced(image: np.ndarray, x: float = 0.0, y: float = 0.0, degrees: float = 0.0) -> np.ndarray:
    """What the picture shows, moved by x to the right and y down, after a clockwise turn about its middle."""
    angle = np.deg2rad(degrees)
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])  # of (row, column)
    middle = (np.array(image.shape[:2]) - 1) / 2
    shift = middle - matrix @ (middle + np.array([y, x]))
    return np.stack(
        [ndimage.affine_transform(image[..., c], matrix, shift, order=5, mode="nearest") for c in range(3)], axis=-1
    )
