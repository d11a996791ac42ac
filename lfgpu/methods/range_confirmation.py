"""Whether a range of disparities that was found holds all surfaces, by the first map that is matched within it.

Evidence for a range are pixels that are like others at one disparity only. What has little texture, or much noise, has
few of them; matched as a whole, it shows where it lies.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfgpu.contract import Float32Array
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.disparity_range import largest_disparity

_AT_END = 0.03  # of the range: matched surfaces that are so near to an end may lie beyond it,
_MANY = 0.01  # if they have that share of the pixels,
_MORE_THAN_BESIDE = 1.25  # and so many times as many as lie beside it on average,
_BESIDE = 2  # in so many times that part of the range
_TRIES = 3  # to widen it there
_FURTHER = 0.5  # by so much of it
_FEW = 0.0025  # share of the pixels that lie at an end by chance


def confirm(
    layout: ViewLayout,
    found: tuple[float, float],
    matched: Float32Array,
    match: Callable[[tuple[float, float]], Float32Array],
) -> str | None:
    """Match within a wider range than the found one while surfaces lie at its ends after all.

    A found range has margins in which no surface lies. What lies beyond it is matched to its ends, and a wider range
    has nothing there. If it has, as with views of nothing but noise, the last range is the found one again.

    Parameters
    ----------
    layout
        The layout of the light field.
    found
        (low, high), pixels per view step.
    matched
        The map [y, x] that was matched within it, pixels per view step, before anything else; NaN where it is unknown.
    match
        Called with each further range; returns the map that was matched within it.

    Returns
    -------
    A sentence if surfaces may lie beyond the found range all the same; else None.
    """
    bounds, most = found, largest_disparity(layout)
    for tries in range(_TRIES + 1):
        piles = [share > _MANY and share > _MORE_THAN_BESIDE * beside for share, beside in _at_ends(bounds, matched)]
        if not any(piles):
            break
        further = _FURTHER * (bounds[1] - bounds[0])
        wider = bounds[0] - further * piles[0], bounds[1] + further * piles[1]
        if tries == _TRIES or max(-wider[0], wider[1]) > most:
            break
        bounds, matched = wider, match(wider)
    moved = [now != before for now, before in zip(bounds, found, strict=True)]
    left = [share > _FEW for share, _ in _at_ends(bounds, matched)]
    if not any(piles) and not any(is_left and is_moved for is_left, is_moved in zip(left, moved, strict=True)):
        return None
    if bounds != found:
        match(found)
    return (
        f"Surfaces may lie beyond the disparity range that was found, from {found[0]:.3g} to {found[1]:.3g} px per "
        "view step: many pixels were matched to its ends, and wider ranges left it open; give disparity_range."
    )


def _at_ends(bounds: tuple[float, float], matched: Float32Array) -> list[tuple[float, float]]:
    """The share of the pixels that lie at the low and at the high end of a range, and of those beside, on average."""
    known, (low, high) = matched[np.isfinite(matched)], bounds
    close = _AT_END * (high - low)
    found = []
    for distance in (known - low, high - known):
        at_end, both = (int((distance <= times * close).sum()) for times in (1, 1 + _BESIDE))
        found.append((at_end / max(1, known.size), (both - at_end) / _BESIDE / max(1, known.size)))
    return found
