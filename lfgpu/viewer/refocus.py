"""Pictures that a light field holds and none of its cameras took: focused on any disparity, or everywhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField

MOST_VIEWS = 81
"""So many views, spread evenly, are enough for a preview."""


def refocus(lf: LightField, disparity: float, *, step: int = 1, most_views: int = MOST_VIEWS) -> NDArray[np.float32]:
    """The mean of the views, each shifted so that what has that disparity comes to lie where the reference sees it.

    Parameters
    ----------
    lf
        The light field.
    disparity
        Where the focus is, pixels per view step.
    step
        Only every `step`-th pixel of each row and column is computed, for previews.
    most_views
        Of more views than this an even choice is taken.

    Returns
    -------
    float32 [y, x, c] in [0, 1]; views that do not reach a pixel, or are not valid there, are left out of its mean.
    """
    height, width = (len(range(0, side, step)) for side in lf.size)
    total = np.zeros((height, width, lf.channels), np.float32)
    weights = np.zeros((height, width, 1), np.float32)
    for index in _chosen(lf, most_views):
        du, dv = lf.offsets[index]
        view, valid = lf.views[index], None if lf.valid is None else lf.valid[index]
        for place, rows, share_y in _taps(-disparity * dv, lf.size[0], step):
            for beside, columns, share_x in _taps(-disparity * du, lf.size[1], step):
                share = np.float32(share_y * share_x)
                weight = share if valid is None else (valid[rows, columns] * share)[..., None]
                total[place, beside] += view[rows, columns] * weight
                weights[place, beside] += weight
    return np.asarray(total / np.maximum(weights, 1e-6) * np.float32(lf.scale), np.float32)


def all_in_focus(
    lf: LightField, disparity: NDArray[np.float32], *, step: int = 1, most_views: int = 25
) -> NDArray[np.float32]:
    """Each pixel focused on its own disparity: the reference with the noise of one view averaged away.

    What another view shows there counts by how alike it is to the reference, so that occluders do not shine through.
    Shapes and types as for `refocus`; `disparity` is [y, x] at full size, and where it is NaN the reference is kept.
    """
    from scipy.ndimage import map_coordinates

    height, width = lf.size
    ys, xs = np.mgrid[0:height:step, 0:width:step].astype(np.float32)
    known = np.isfinite(disparity)
    d = np.where(known, disparity, 0)[::step, ::step]
    reference = lf.image(lf.reference_index)[::step, ::step]
    total, weights = reference.copy(), np.ones((*reference.shape[:2], 1), np.float32)
    for index in _chosen(lf, most_views):
        if index == lf.reference_index:
            continue
        du, dv = (float(offset) for offset in lf.offsets[index])
        where = np.stack([ys - d * dv, xs - d * du])
        inside = (where[0] >= 0) & (where[0] <= height - 1) & (where[1] >= 0) & (where[1] <= width - 1)
        view = lf.views[index]
        seen = np.stack(
            [map_coordinates(view[..., c], where, np.float32, order=1, mode="nearest") for c in range(lf.channels)],
            axis=-1,
        ) * np.float32(lf.scale)
        alike = np.exp(-((seen - reference) ** 2).mean(axis=-1) / (2 * _ALIKE**2)) * (inside & known[::step, ::step])
        total += seen * alike[..., None]
        weights += alike[..., None]
    return np.asarray(total / weights, np.float32)


_ALIKE = 0.03  # intensity: differences of this size are noise, much larger ones another surface


def _chosen(lf: LightField, most: int) -> NDArray[np.intp]:
    """Indices of at most that many views, spread evenly over the order in which they are stored."""
    count = len(lf.views)
    if count <= most:
        return np.arange(count)
    return np.unique(np.append(np.linspace(0, count - 1, most - 1).round().astype(np.intp), lf.reference_index))


def _taps(shift: float, length: int, step: int) -> Iterator[tuple[slice, slice, float]]:
    """For pixels 0, step, 2 step ...: which of them have a pixel `shift` beside them, where it is, and its share.

    There are two of these, between which it lies: the shift is no whole number.
    """
    whole = int(np.floor(shift))
    for beside, share in ((whole, whole + 1 - shift), (whole + 1, shift - whole)):
        first = max(0, -(beside // step))  # the first k with k step + beside >= 0
        last = (length - 1 - min(max(beside, 0), length)) // step + 1 if beside > 0 else (length - 1) // step + 1
        if share > 0 and first < last:
            start = first * step + beside
            yield slice(first, last), slice(start, (last - 1) * step + beside + 1, step), share
