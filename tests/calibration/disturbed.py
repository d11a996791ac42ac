"""Light fields one view of which is not as it should be."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lfgpu.data.lightfield import LightField


def truth(lf: LightField) -> np.ndarray:
    """The true disparity of the reference view, [y, x]."""
    return lf.truth.disparity


def with_view(lf: LightField, index: int, change: Callable[[np.ndarray], np.ndarray]) -> LightField:
    """With what `change` makes of one view, float64 [y, x, c] in stored units."""
    views = lf.views.copy()
    views[index] = np.clip(np.rint(change(views[index].astype(np.float64))), 0, 255)
    return replace(lf, views=views)
