"""Black corners of views, which the round exit pupil of a lens leaves; they are masked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import each_view

_BLACK = 0.016  # intensity: 4 of 255
_LEAST, _MOST = 1e-4, 0.3  # share of all pixels: fewer black ones are no vignette, and more are a dark scene
_RIM = 2  # pixels: width of the darkened rim around the black region


def without_black_corners(lf: LightField) -> LightField:
    """Mask the black corners of a light field, and add a note.

    Black corners do not move from view to view, so matching would give them disparity 0. A region of black pixels is
    masked if it is connected to pixels that are black in all views, and these are connected to a corner. All four
    corners must be black. A light field that has a mask, or no black corners, is returned unchanged.
    """
    corners = (0, 0, -1, -1), (0, -1, 0, -1)
    threshold = _BLACK / lf.scale
    if lf.valid is not None or np.any(lf.views[(slice(None), *corners)] > threshold):
        return lf
    from scipy.ndimage import binary_dilation, label  # slow to import, and rarely needed

    black = np.empty(lf.views.shape[:3], np.bool_)

    def look(index: int, view: NDArray[Any]) -> None:
        black[index] = np.all(view <= threshold, axis=2)

    each_view(lf.views, range(len(black)), look)
    always = _connected(label(black.all(0))[0], corners)
    if not _LEAST <= always.mean() <= _MOST:
        return lf
    rim = np.ones((2 * _RIM + 1, 2 * _RIM + 1), np.bool_)
    valid = np.stack([~binary_dilation(_connected(label(view)[0], np.nonzero(always)), rim) for view in black])
    note = f"The corners are black: {100 * (1 - valid.mean()):.1f} % of the pixels are not used."
    return replace(lf, valid=valid, notes=(*lf.notes, note))


def _connected(labels: NDArray[np.int32], seeds: Any) -> NDArray[np.bool_]:
    """Select the labelled regions that contain the pixels `seeds`."""
    found = np.unique(labels[seeds])
    return np.isin(labels, found[found > 0])
