"""Exposure of a light field: intensities are large or small beside the light that the views have."""

from __future__ import annotations

import math

import numpy as np

from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import check_unchanged

_SIDE = 256  # pixels: about as many rows and columns of the reference view are looked at
_BRIGHT = 99  # percentile: what is brighter may be lamps and glints


def exposure_of(lf: LightField) -> float:
    """Measure the part of the range of intensities that the views use: 1, 1/2, 1/4 and so on.

    It is the smallest of these numbers that is not below the bright parts of the reference view, so views that use the
    upper half of the range have 1. The methods scale by it what they compare intensities with.
    """
    check_unchanged(lf.views)
    step = max(1, min(lf.size) // _SIDE)
    view = lf.views[lf.reference_index, ::step, ::step]
    values = view if lf.valid is None else view[lf.valid[lf.reference_index, ::step, ::step]]
    bright = float(np.percentile(values, _BRIGHT)) * lf.scale if values.size else 0.0
    return 2.0 ** min(0, math.ceil(math.log2(bright))) if bright > 0 else 1.0
