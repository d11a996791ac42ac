"""Pixels of a lens array's views that recorded something: its corners look past the main lens and are dark."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField

_DARK = 0.5  # share of the middle view's brightness below which a pixel counts as dark
_AROUND = 16  # brightness is that of a window of a 16th of the shorter side: parallax must not look like shadow


def lit(light_field: LightField) -> NDArray[np.bool_]:
    """Mark, bool [n, y, x], where a view is at least half as bright as the reference view is around the same place."""
    from scipy import ndimage  # not for those who read something else

    window = max(5, min(light_field.size) // _AROUND)

    def brightness(index: int) -> NDArray[np.float32]:
        grey = light_field.image(index).mean(axis=2)
        return np.asarray(ndimage.uniform_filter(grey, window, mode="nearest"))

    least = _DARK * brightness(light_field.reference_index)
    return np.stack([brightness(index) >= least for index in range(len(light_field.views))])
