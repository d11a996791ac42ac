"""Confirmation of a disparity range that was found, by the first map that is matched within it.

Evidence for a range are pixels that match others at one disparity only. Surfaces with little texture, or much noise,
have few such pixels; only a map of all pixels shows where they lie.
"""

from collections.abc import Callable

import numpy as np

from lfgpu.contract import Float32Array
from lfgpu.data import ViewLayout
from lfgpu.methods.disparity_range import largest_disparity
from lfgpu.pipelines.verdict import MANY

_MARGIN = 0.03  # of the range: matched surfaces within this distance from an end may lie beyond it
_MORE_THAN_BESIDE = 1.25  # times: as many pixels must lie in the margin as on average beside it,
_BESIDE = 2  # in that many margins
_TRIES = 3  # to widen the range
_FURTHER = 0.5  # of the range, at that end
_FEW = 0.0025  # share of the pixels that lie in a margin by chance


def confirm(
    layout: ViewLayout,
    found: tuple[float, float],
    matched: Float32Array,
    match: Callable[[tuple[float, float]], Float32Array],
) -> str | None:
    """Match within a wider range than the found one while surfaces lie at its ends after all.

    A found range has margins in which no surface lies. Surfaces beyond it are matched to its ends, and a wider range
    has nothing there. If it has, as with views of pure noise, the last range is the found one again. `matched` is the
    map [y, x] within it before anything else; `match` returns that within a further range. Returns a sentence if
    surfaces may lie beyond the found range all the same.
    """
    bounds, most = found, largest_disparity(layout)
    for tries in range(_TRIES + 1):
        ends = _at_ends(bounds, matched)
        piles = [share > MANY and share > _MORE_THAN_BESIDE * beside for share, beside in ends]
        if not any(piles):
            break
        further = _FURTHER * (bounds[1] - bounds[0])
        wider = bounds[0] - further * piles[0], bounds[1] + further * piles[1]
        if tries == _TRIES or max(-wider[0], wider[1]) > most:
            break
        bounds, matched = wider, match(wider)
    moved = [now != before for now, before in zip(bounds, found, strict=True)]
    left = [is_moved and share > _FEW for (share, _), is_moved in zip(ends, moved, strict=True)]
    if not any(piles) and not any(left):
        return None
    if bounds != found:
        match(found)
    return (
        f"Surfaces may lie beyond the disparity range that was found, from {found[0]:.3g} to {found[1]:.3g} px per "
        "view step: many pixels were matched to its ends, and wider ranges left it open; give "
        "disparity_range (--disparity-range on the command line)."
    )


def _at_ends(bounds: tuple[float, float], matched: Float32Array) -> list[tuple[float, float]]:
    """Measure the share of the pixels at the low and at the high end of a range, and of those beside, on average."""
    (low, high), known = bounds, max(1, int(np.count_nonzero(np.isfinite(matched))))
    close = _MARGIN * (high - low)
    far, found = 2 * (1 + _BESIDE) * close, []
    # Few pixels are near an end: what is farther needs no memory. Where it is unknown it is near nothing.
    for distance in (matched[matched <= low + far] - low, high - matched[matched >= high - far]):
        at_end, both = (int(np.count_nonzero(distance <= times * close)) for times in (1, 1 + _BESIDE))
        found.append((at_end / known, (both - at_end) / _BESIDE / known))
    return found
