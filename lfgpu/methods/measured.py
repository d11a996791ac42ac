"""Measurements on a light field before the estimate: its disparity range, its noise and its exposure."""

import math
from dataclasses import dataclass

import numpy as np

from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import check_unchanged
from lfgpu.errors import LightFieldError


@dataclass(frozen=True)
class Seen:
    """The grain and the exposure of a light field, whatever its disparities; as in `Measured`."""

    grain: float
    exposure: float


@dataclass(frozen=True)
class Measured:
    """The disparity range and the noise of a light field: measured once, checked once, then passed on.

    What a method does not use is None.
    """

    disparity_range: tuple[float, float]  # (low, high) in pixels per view step
    noise: float | None = None  # root mean square difference between views of the same point, intensity
    grain: float | None = None  # standard deviation of the noise of one view, intensity
    spread: tuple[float, float] | None = None  # standard deviations of colours and gradients of the reference view
    exposure: float = 1.0  # part of the range of intensities that the views use (`exposure_of`)


def checked_range(disparity_range: tuple[float, float], layout: ViewLayout) -> tuple[float, float]:
    """Convert a range that the user gave to two numbers; raise LightFieldError if this light field cannot have it."""
    try:
        low, high = (float(bound) for bound in disparity_range)
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise LightFieldError(
            "disparity range must be two finite numbers, low < high, in pixels per view step; found "
            f"{disparity_range!r}."
        )
    distances = np.abs(layout.offsets).max(1)
    nearest, size = distances[distances > 0].min(), max(layout.size)
    if max(abs(low), abs(high)) * nearest >= size:
        raise LightFieldError(
            f"disparity range {low:g} to {high:g} is too large for views of {size} px: it shifts even the nearest view "
            f"by {max(abs(low), abs(high)) * nearest:g} px; give smaller disparities, in pixels per view step."
        )
    return low, high


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
