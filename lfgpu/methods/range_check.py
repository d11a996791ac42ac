"""Whether a range of disparities that somebody gave is one in which the scene can lie."""

from __future__ import annotations

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range

_LEAST = 0.25  # share of the range that the views show; the found one has margins, and outliers may widen it


def range_remark(lf: LightField, given: tuple[float, float]) -> str | None:
    """A sentence if a given range, pixels per view step, excludes most of what the views show; else None.

    No map says so by itself: within a wrong range some disparity is the best everywhere, often with confidence.
    """
    try:
        low, high = find_disparity_range(lf)
    except LightFieldError:  # the views tell nothing
        return None
    shared = min(high, given[1]) - max(low, given[0])
    if shared >= _LEAST * min(high - low, given[1] - given[0]):
        return None
    return (
        f"The views show disparities from {low:.2f} to {high:.2f} px per view step, which the given range from "
        f"{given[0]:.2f} to {given[1]:.2f} mostly excludes: the map may be wrong everywhere, whatever its confidence; "
        "leave the range out, or widen it."
    )
