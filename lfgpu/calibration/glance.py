"""A glance at the cameras of a light field of which there is no map: is anything wrong with all of them?

Some points with texture get their disparities from a small plane sweep. That is enough to tell which way the axes are
counted and, by photometric bundle adjustment, whether views are out of line or differ in brightness. No kernels are
needed, so that none have to be compiled for it.
"""

from __future__ import annotations

import numpy as np

from lfgpu._backends import DEFAULT, open_device
from lfgpu.calibration import signs
from lfgpu.calibration.bundle import Points, grey, inner, textured
from lfgpu.calibration.findings import SIGNS
from lfgpu.calibration.quick_look import array_wide, part_of
from lfgpu.calibration.sweep import LABELS, patches, sweep
from lfgpu.contract import Float32Array
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range

_VIEWS, _PIXELS = 25, 2_000_000
_POINTS = 400
_SWEPT = 12  # views that disparities are found from
_FEWEST = 100  # points at which views agree
_AGREE = 0.6  # of the contrast: where patches differ by more, the point is hidden or has no disparity in the range


def glance(lf: LightField) -> str | None:
    """What stands out about all cameras together, a sentence; None if nothing does, or if the views do not tell.

    It looks at 25 views at most, and at their middle with 2 million pixels in all, so that it takes about a second
    whatever the size of the light field. Faults of single views are left to `explain`, and so are both axes that are
    counted the wrong way: that takes a map.
    """
    part, _ = part_of(lf, views=_VIEWS, pixels=_PIXELS)
    known = np.ones(part.size, np.bool_) if part.valid is None else part.valid[part.reference_index]
    y, x, tile = textured(part, inner(known), _POINTS)
    if not len(x):
        return None
    try:
        low, high = find_disparity_range(part, open_device(DEFAULT, "cpu"))
    except LightFieldError:
        return None
    others = np.flatnonzero(np.arange(len(part.views)) != part.reference_index)
    swept = np.random.default_rng(0).permutation(others)[:_SWEPT]
    pictures: list[Float32Array] = [grey(part, int(n)) for n in swept]
    shown = patches(grey(part, part.reference_index), x, y)
    cost, disparity = sweep(shown, pictures, part.offsets[swept], x, y, np.linspace(low, high, LABELS))
    points = Points(x.astype(float), y.astype(float), disparity, np.ones((len(part.views), len(x)), np.float32), tile)
    if (wrong := signs.wrong_axis(part, points, max(abs(low), abs(high)))) is not None:
        return SIGNS[wrong]
    agree = cost < _AGREE
    if agree.sum() < _FEWEST:
        return None
    kept = Points(points.x[agree], points.y[agree], disparity[agree], points.visible[:, agree], tile[agree])
    findings = array_wide(part, kept)
    return findings[0] if findings else None


__all__ = ["glance"]
