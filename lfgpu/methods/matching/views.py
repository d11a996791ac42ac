"""View rules: which views each pass compares. A rule is a function here and a row of `VIEWS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lfgpu.contract import Float64Array
from lfgpu.data.layout import ViewLayout, in_pattern
from lfgpu.methods.matching.config import MatchingConfig, SweepConfig
from lfgpu.methods.matching.disparities import compared_reach
from lfgpu.methods.matching.tuning import in_wide_ranges

ViewRule = Callable[[ViewLayout, str], list[int]]
"""Chooses views of a layout, given `sweep.views`: indices in order, the reference among them."""

_FEWEST = 4  # views beside the reference that a pattern must have
_ON_PLACE = 1e-3  # view steps: a view that is farther from every place of a grid is beside it
_CHESSBOARD = {"alternate": 40, "cross": 9}  # views that must be left of the fields of one colour, by `sweep.views`
_EVERY_OTHER = {"alternate": 25}  # views that must be left of every other row and column, by `sweep.views`


def used_views(offsets: Float64Array, pattern: str) -> list[int]:
    """Choose the views of a pattern, or all views if fewer than four beside the reference are in it."""
    used = np.flatnonzero(in_pattern(offsets, "full" if pattern == "alternate" else pattern))
    return _indices(used if len(used) > _FEWEST else np.arange(len(offsets)))


def compared_views(layout: ViewLayout, pattern: str) -> list[int]:
    """Choose the used views that all sweeps, and all steps of the alignment but the last, choose from.

    For the patterns "alternate" and "cross" these are the fields of the reference's colour on a chessboard; where too
    few would be left, the views that `every_other_view` chooses. For other patterns they are all.
    """
    places = _places(layout) if pattern in _CHESSBOARD else None
    if places is None:
        return _all(layout, pattern)
    chosen = np.flatnonzero(places.sum(1) % 2 == 0)
    return _indices(chosen) if len(chosen) >= _CHESSBOARD[pattern] else every_other_view(layout, pattern)


def every_other_view(layout: ViewLayout, pattern: str) -> list[int]:
    """Choose every other row and column of a grid, from the outermost ones to the reference's.

    All views are chosen unless the pattern is "alternate" and 25 views or more are left.
    """
    places = _places(layout) if pattern in _EVERY_OTHER else None
    if places is not None:
        inwards = np.where(places > 0, places.max(0) - places, places - places.min(0))
        chosen = np.flatnonzero(((inwards % 2 == 0) | (places == 0)).all(1))
        if len(chosen) >= _EVERY_OTHER[pattern]:
            return _indices(chosen)
    return _all(layout, pattern)


def _all(layout: ViewLayout, pattern: str) -> list[int]:
    return list(range(layout.count))


VIEWS: Mapping[str, ViewRule] = {
    "all": _all,
    "cross": lambda layout, _: used_views(layout.offsets, "cross"),
    "every other": every_other_view,
}
"""Rules by name, each for the compared views of a sweep."""


@dataclass(frozen=True)
class ChosenViews:
    """The views that the passes of a plan compare, as layouts."""

    given: list[int] | None  # indices of the used views among all; None if all are used
    used: ViewLayout
    chosen: list[int] | None  # indices of the compared views among the used ones; None if all are compared
    compared: ViewLayout
    reach: float  # distance of the farthest views from which the compared ones are chosen, view steps

    @property
    def is_wide(self) -> bool:
        """True if the range is so wide that sweeps compare views near the reference only."""
        return self.reach < self.used.farthest

    def adapt(self, config: MatchingConfig) -> MatchingConfig:
        """Return the parameters for these views: in a wide range, and where the views lie to one side."""
        if self.is_wide:
            config = replace(config, tuning=in_wide_ranges(config.tuning))
        if not are_around(self.compared.offsets):  # a widened surface would hide what no view shows beside it
            config = replace(config, sweep=replace(config.sweep, resweeps=min(config.sweep.resweeps, 1)))
        return config


def chosen_views(layout: ViewLayout, bounds: tuple[float, float], config: SweepConfig) -> ChosenViews:
    """Apply `sweep.views` to a layout, and leave the views near the reference where the range is wide."""
    given = used_views(layout.offsets, config.views)
    used = layout.subset(given)
    reach = compared_reach(used.offsets, bounds, config)
    near = np.flatnonzero(np.abs(used.offsets).max(1) <= reach)
    chosen = _indices(near[compared_views(used.subset(near), config.views)])
    return ChosenViews(
        given if used.count < layout.count else None,
        used,
        chosen if len(chosen) < used.count else None,
        used.subset(chosen),
        reach,
    )


def offsets_of(layout: ViewLayout, chosen: list[int] | None) -> Float64Array:
    """Return (du, dv) of the views of a layout [n, 2], NaN for those that are not chosen; None chooses all."""
    if chosen is None:
        return layout.offsets
    offsets = np.full_like(layout.offsets, np.nan)
    offsets[chosen] = layout.offsets[chosen]
    return offsets


def are_around(offsets: Float64Array) -> bool:
    """Tell whether views at `offsets` [n, 2] surround the reference: their directions leave no half of a turn open."""
    du, dv = offsets[np.hypot(*offsets.T) > _ON_PLACE].T
    turns = np.sort(np.arctan2(dv, du))
    return bool(np.diff(turns, append=turns[:1] + 2 * np.pi).max(initial=0) < np.pi - _ON_PLACE)


def _places(layout: ViewLayout) -> Float64Array | None:
    """Find the places of views in a grid, in view steps from the reference; None if a view is beside them."""
    places = np.rint(layout.offsets)
    return places if np.abs(layout.offsets - places).max() < _ON_PLACE else None


def _indices(chosen: np.ndarray) -> list[int]:
    return [int(index) for index in chosen]
