"""What hides what, by a map: which points a view does not see, and whether near hides far as it should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration.bundle import TOLERANCE, farthest, grey
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField

_GAP = 2.0  # pixels in the farthest view: what is nearer by more hides what is behind it
_DIFFERENT = 0.03  # intensity: colours that can be told apart
_MOST = 0.1  # intensity: larger differences count as much
_PARTS = 12  # along the longer side: pixels of one part are of one outline


def hidden(
    lf: LightField, map_: NDArray[np.float32], y: NDArray[np.intp], x: NDArray[np.intp], index: int
) -> NDArray[np.bool_]:
    """Whether something nearer lands where points of the reference [p] land in a view.

    What is nearer by k pixels there lies k pixels beside the point in the reference, along the offset.
    """
    (du, dv), (height, width) = lf.offsets[index], lf.size
    d, distance = map_[y, x].astype(np.float64), float(np.hypot(du, dv))
    if distance == 0:
        return np.zeros(len(d), np.bool_)
    steps = np.arange(1, int(np.ceil((float(map_.max()) - float(d.min())) * distance)) + 1)[:, None] / distance
    rows = np.rint(y + steps * dv).astype(np.intp)
    columns = np.rint(x + steps * du).astype(np.intp)
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    nearer = map_[rows.clip(0, height - 1), columns.clip(0, width - 1)] - d
    least = np.maximum(steps - 0.7 / distance, TOLERANCE / farthest(lf))
    return np.asarray((inside & (nearer >= least) & (nearer <= steps + 0.7 / distance)).any(0))


@dataclass(frozen=True, eq=False)
class Order:
    """How well views show what is near, or what is far, where the map says that both land at one pixel.

    Parameters
    ----------
    told
        Number of such pixels, of all views that were looked at.
    near, far
        float64 [t], sums of the absolute differences from what is near and from what is far, intensity, for each part
        of the picture that has such pixels.
    """

    told: int
    near: Float64Array
    far: Float64Array


def order_of_depth(lf: LightField, disparity: NDArray[np.floating], *, views: int) -> Order:
    """Compare the views that are farthest from the reference with its map [y, x], NaN where not known."""
    known = np.isfinite(disparity)
    if lf.valid is not None:
        known &= lf.valid[lf.reference_index]
    distance = np.hypot(*lf.offsets.T)
    image, (height, width) = grey(lf, lf.reference_index).ravel(), lf.size
    map_ = disparity.ravel()
    order = np.argsort(map_, kind="stable")
    order = order[known.ravel()[order]].astype(np.int32)
    d, (rows, columns) = map_[order], np.divmod(order, np.int32(width))
    side = max(lf.size) / _PARTS
    told, near, far = 0, np.zeros(_PARTS**2), np.zeros(_PARTS**2)
    for n in np.argsort(-distance, kind="stable")[:views]:
        du, dv = lf.offsets[n]
        x, y = np.rint(columns - d * du).astype(np.int32), np.rint(rows - d * dv).astype(np.int32)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        if lf.valid is not None:
            inside[inside] = lf.valid[n][y[inside], x[inside]]
        landed, place = order[inside], y[inside] * np.int32(width) + x[inside]
        front, back = np.full(height * width, -1, np.int32), np.full(height * width, -1, np.int32)
        front[place], back[place[::-1]] = landed, landed[::-1]  # the last one stays
        there = np.flatnonzero(front >= 0)
        if not len(there):
            continue
        # How bright the whole view is does not say what hides what.
        shown = grey(lf, int(n)).ravel()
        brighter = float(image[front[there]].mean()) / max(float(shown[there].mean()), 1e-6)
        both = np.flatnonzero(front != back)
        front, back = front[both], back[both]
        apart = (map_[front] - map_[back] > _GAP / distance.max()) & (np.abs(image[front] - image[back]) > _DIFFERENT)
        front, back, shown = front[apart], back[apart], brighter * shown[both[apart]]
        row, column = np.divmod(front, width)
        part = (row / side).astype(np.intp) * _PARTS + (column / side).astype(np.intp)
        told += len(part)
        for loss, seen in ((near, front), (far, back)):
            loss += np.bincount(part, np.minimum(np.abs(shown - image[seen]), _MOST), len(loss))
    some = near + far > 0
    return Order(told, near[some], far[some])


__all__ = ["Order", "hidden", "order_of_depth"]
