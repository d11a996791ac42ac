"""What a plane sweep compares: which views, in which partial sets, at which disparities."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lfgpu.contract import Device, Disparities, Float64Array, PlaneSweep, SweepCost, ViewSets
from lfgpu.data.layout import ViewLayout, farthest
from lfgpu.methods.matching.config import SweepConfig

_DIRECTIONS = 8  # in which some of the views lie
_FEWEST = 4  # views beside the reference that a pattern must have
_ON_LINE = 1e-3  # view steps
_ON_BOUND = 1e-6  # steps: what is so near to a bound lies on it
_FEWEST_LABELS = 3  # a minimum between two disparities is found from three
_MANY = {"alternate": 40, "cross": 9}  # views that must be left of a chessboard
_ENOUGH = 25  # and of every other row and column


def planned_sweep(
    shape: Sequence[int],
    offsets: Float64Array,
    place: tuple[float, float, int],
    config: SweepConfig,
    device: Device,
    *,
    scale: float,
) -> PlaneSweep:
    """A sweep over views of `shape` [n, y, x, c], `offsets` [n, 2] apart, at the disparities of `labels`."""
    views = ViewSets(
        device.field(offsets),
        device.field(view_sets(offsets, config.view_set_angle)),
        preference=config.view_set_penalty,
        tolerance=config.tolerance / farthest(offsets),
        least=max(1, math.ceil(config.min_share * (len(offsets) - 1))),
    )
    return device.kernels.plane_sweep(shape, views, Disparities(*place), scale=scale)


def sweep_cost(config: SweepConfig, gradient_weight: float) -> SweepCost:
    """The cost of views that differ, with that weight of gradients."""
    softness = config.softness * config.noise
    return SweepCost(config.truncation, gradient_weight, config.gradient_truncation, softness)


def noise_cost(config: SweepConfig) -> float:
    """What a difference in intensity as large as the noise costs, if gradients do not differ."""
    softness = config.softness
    return 2 * softness * config.noise * (math.sqrt(1 + 1 / softness) - 1) if softness else config.noise


def used_views(layout: ViewLayout, pattern: str) -> list[int]:
    """Indices of the views of a pattern, in order, or of all if fewer than four beside the reference are in it."""
    used = [int(index) for index in np.flatnonzero(layout.pattern("full" if pattern == "alternate" else pattern))]
    return used if len(used) > _FEWEST else list(range(layout.count))


def swept_views(offsets: Float64Array, pattern: str) -> list[int]:
    """Indices of those of the used views, `offsets` [n, 2] apart, which all steps before the alignment's last take.

    These are all of them but for "alternate" and "cross": then those of one colour, where the places of a grid are
    coloured as the squares of a chessboard, the reference among them. Where fewer than 40 or 9 would be left, they are
    those that `middle_views` finds among all.
    """
    places = _places(offsets) if pattern in _MANY else None
    if places is None:
        return list(range(len(offsets)))
    alternate = np.flatnonzero(places.sum(1) % 2 == 0)
    return [int(index) for index in alternate] if len(alternate) >= _MANY[pattern] else middle_views(offsets, pattern)


def middle_views(offsets: Float64Array, pattern: str) -> list[int]:
    """Indices of those of the swept views, `offsets` [n, 2] apart, which the sweeps between first and last compare.

    These are all of them but for "alternate": then those of every other row and column of a grid, from the outermost
    ones to the reference's, if 25 or more are left.
    """
    places = _places(offsets) if pattern == "alternate" else None
    if places is not None:
        inwards = np.where(places > 0, places.max(0) - places, places - places.min(0))
        chosen = np.flatnonzero(((inwards % 2 == 0) | (places == 0)).all(1))
        if len(chosen) >= _ENOUGH:
            return [int(index) for index in chosen]
    return list(range(len(offsets)))


def _places(offsets: Float64Array) -> Float64Array | None:
    """The places in a grid; None if views are beside these."""
    places = np.rint(offsets)
    return places if np.abs(offsets - places).max() < _ON_LINE else None


def first_views(layout: ViewLayout, pattern: str) -> list[int]:
    """Indices of the views that the first sweep compares, in order, of all [n] that are swept."""
    return used_views(layout, "full" if pattern == "all" else pattern)


def further_sweeps(offsets: Float64Array, config: SweepConfig) -> int:
    """How many sweeps follow the first one over views `offsets` [n, 2] apart.

    From the second of them on, surfaces are widened before they hide anything. That needs views on all sides: in a row
    of views, what lies above something near is never seen at a distance from it, and would be hidden for ever. Where
    the directions of the views leave half of a turn open, at most one sweep follows.
    """
    du, dv = offsets[np.hypot(*offsets.T) > _ON_LINE].T
    turns = np.sort(np.arctan2(dv, du))
    is_surrounded = np.diff(turns, append=turns[:1] + 2 * np.pi).max(initial=0) < np.pi - _ON_LINE
    return config.resweeps if is_surrounded else min(config.resweeps, 1)


def labels(bounds: tuple[float, float], offsets: Float64Array, config: SweepConfig) -> tuple[float, float, int]:
    """First, distance and number of the disparities that are compared: odd halves of a step that cover the bounds.

    A step is `config.step` pixels in the farthest view, or as long as it takes for `config.max_labels` of them. The
    outermost ones are on a bound or less than a step beyond it: maps are clamped, so surfaces beyond a bound end up on
    it. If disparities went from bound to bound, a slightly wider range would move all of them, and with them each pixel
    that is almost as well matched elsewhere.
    """
    low, high = bounds
    step = max(config.step / farthest(offsets), (high - low) / (config.max_labels - 2))
    begin, end = math.floor(low / step - 0.5 + _ON_BOUND), math.ceil(high / step - 0.5 - _ON_BOUND)
    return (begin + 0.5) * step, step, max(end - begin + 1, _FEWEST_LABELS)


def view_sets(offsets: Float64Array, angle: float) -> Float64Array:
    """Which views belong together, [m, n] of 1 and 0: first all, then those within an angle (degrees) around the
    reference, each with the views on its borders; those that repeat others or are empty left out.
    """
    turns = 2 * np.pi * np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS
    along = np.cos(turns) * offsets[:, 0] + np.sin(turns) * offsets[:, 1]
    ahead = along - math.cos(math.radians(angle) / 2) * np.hypot(*offsets.T) > -_ON_LINE
    others = np.abs(offsets).max(1) > _ON_LINE
    found: dict[bytes, Float64Array] = {}
    for view_set in (np.ones(len(offsets), bool), *ahead):
        used = np.asarray(view_set & others, np.float64)
        if used.any():
            found.setdefault(used.tobytes(), np.asarray(view_set, np.float64))
    return np.stack(list(found.values()))
