"""Measurements on a light field before the estimate: its disparity range, its noise and its exposure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfgpu.contract import Array, Device, Scalar
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import check_unchanged
from lfgpu.errors import LightFieldError


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
    except (OverflowError, TypeError, ValueError):
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


Shown = tuple[Array, Sequence[int]]
"""Views [n, y, x, c] of a light field that are on the device, and which these are."""


def load_window(
    lf: LightField, chosen: Sequence[int], y: slice, x: slice, device: Device, shown: Shown | None, *, views_out: Array
) -> None:
    """Copy a window of some views into an image of their type, on the device if they are there."""
    check_unchanged(lf.views)
    views, held = shown or (None, ())
    if set(chosen) <= set(held):
        line, corner = [held.index(view) for view in chosen], (y.start, x.start)
        device.kernels.line_of_views(views, line, vertical=False, corner=corner, epis_out=views_out)
    else:
        device.kernels.upload(lf.views[:, y, x], views_out, chosen=chosen)


class Typical:
    """The median of differences at the half of the pixels, or more, where they vary most.

    Pixels without texture agree at all disparities. Where `variation` is NaN a pixel has no say.
    """

    def __init__(self, device: Device) -> None:
        self._quantile, self._half, self._found = device.kernels.quantile, device.scalar(0.0), device.scalar(0.0)

    def __call__(self, differences: Array, variation: Array) -> Scalar:
        self._quantile(variation, 0.5, quantile_out=self._half)
        self._quantile(differences, 0.5, quantile_out=self._found, among=variation, least=self._half)
        return self._found


_ROWS = 256  # about as many of the reference view are looked at
_BRIGHT = 0.01  # share of the values, above which there may be lamps and glints


def exposure_of(lf: LightField) -> float:
    """Measure the part of the range of intensities that the views use: 1, 1/2, 1/4 and so on.

    It is the smallest of these numbers that is not below the bright parts of the reference view, so views that use the
    upper half of the range have 1. The methods scale by it what they compare intensities with.
    """
    check_unchanged(lf.views)
    rows = lf.reference_index, slice(None, None, max(1, lf.size[0] // _ROWS))
    values = lf.views[rows] if lf.valid is None else lf.views[rows][lf.valid[rows]]

    def is_below(bright: float) -> bool:
        return bool(np.count_nonzero(values > values.dtype.type(bright / lf.scale)) <= _BRIGHT * (values.size - 1))

    exposure = 1.0
    while is_below(exposure / 2) and not is_below(0.0):
        exposure /= 2
    return exposure
