"""Black corners: what the round exit of a lens leaves of the views that a lens array records."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import each_view

_BLACK = 0.016  # intensity: 4 of 255
_LEAST, _MOST = 1e-4, 0.3  # of all pixels: a few black ones are nothing, and a night scene has no vignette
_RIM = 2  # pixels that are darker than they should be, beside those that are black


def without_black_corners(lf: LightField) -> LightField:
    """The light field with what is black in its corners marked as not valid, and a note that says so.

    Black corners stand still while the scene moves from view to view: matched, they have the disparity 0. A pixel is
    taken for one of theirs if it is black, and connected through black pixels to one that is black in all views, which
    in turn is connected to a corner in this way; and if all four corners are so. A light field that has a mask, or
    nothing of that kind, comes back as it is.
    """
    corners = (0, 0, -1, -1), (0, -1, 0, -1)
    threshold = _BLACK / lf.scale
    if lf.valid is not None or np.any(lf.views[(slice(None), *corners)] > threshold):
        return lf
    from scipy.ndimage import binary_dilation, label  # takes long to import, and most light fields have no such corners

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
    """The regions of some pixels."""
    found = np.unique(labels[seeds])
    return np.isin(labels, found[found > 0])
