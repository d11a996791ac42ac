"""The disparities that sweeps compare, and the partial view sets."""

from __future__ import annotations

import math

import numpy as np

from lfgpu.contract import Disparities, Float64Array
from lfgpu.methods.matching.config import SweepConfig
from lfgpu.methods.matching.learned import DISPARITIES

_DIRECTIONS = 8  # in which partial view sets lie
_ON_LINE = 1e-3  # view steps: a view that is nearer to a border lies on it
_ON_BOUND = 1e-6  # steps: a disparity that is nearer to a bound lies on it
NETWORK_STEP = 0.5
"""Pixels in the farthest view between disparities of the networks, as they were trained."""

NETWORK_MOST = 64
"""Disparities that the network of whole ranges compares at most: it was trained with 48, and goes a little further."""

PADDED = 5
"""Disparities that it compares beside those that span the range: it was trained to find surfaces inside."""

WINDOW = 12
"""Disparities that the network of windows compares, as it was trained."""

_FEWEST = 3  # a minimum between two disparities is found from three
_FEWEST_VIEWS = 4  # beside the reference, which wide ranges leave


def compared_disparities(
    bounds: tuple[float, float], farthest: float, config: SweepConfig, *, multiple: int = 1
) -> Disparities:
    """Choose the disparities that are compared: odd halves of a step that cover the bounds.

    Volumes have room for a `multiple` of so many.

    A step is `config.step` pixels in the farthest view, or as long as it takes for `config.max_labels` disparities. The
    outermost disparities are on a bound or less than a step beyond it: maps are clamped, so surfaces beyond a bound end
    up on it. If disparities went from bound to bound, a slightly wider range would move all of them, and with them each
    pixel that is almost as well matched elsewhere.
    """
    low, high = bounds
    step = max(config.step / farthest, (high - low) / (config.max_labels - 2))
    begin, end = math.floor(low / step - 0.5 + _ON_BOUND), math.ceil(high / step - 0.5 - _ON_BOUND)
    count = max(end - begin + 1, _FEWEST)
    return Disparities((begin + 0.5) * step, step, count, count + -count % multiple)


def compared_reach(offsets: Float64Array, bounds: tuple[float, float], config: SweepConfig) -> float:
    """Return the distance of the farthest views at `offsets` [n, 2] that sweeps compare, view steps.

    It is as large as `config.max_labels` disparities allow at steps of `config.step` pixels there, but at least four
    views are left beside the reference.
    """
    return reach_for(offsets, bounds[1] - bounds[0], step=config.step, count=config.max_labels - 2)


def reach_for(offsets: Float64Array, span: float, *, step: float, count: int) -> float:
    """Return how far out views may be, view steps, for `count` steps of `step` pixels there to cover a span.

    The span is in pixels per view step. At least four views beside the reference are not farther out, whatever it is.
    """
    distances = np.sort(np.abs(offsets).max(1))
    fits = distances[_FEWEST_VIEWS:] * span <= step * count
    return float(distances[-1] if len(fits) == 0 else distances[_FEWEST_VIEWS + max(int(fits.sum()), 1) - 1])


def network_reach(offsets: Float64Array, bounds: tuple[float, float]) -> float:
    """Return the distance of the farthest views that the network of whole ranges compares, view steps."""
    return reach_for(offsets, bounds[1] - bounds[0], step=NETWORK_STEP, count=NETWORK_MOST - PADDED)


def padded_disparities(bounds: tuple[float, float], farthest: float) -> Disparities:
    """Choose the disparities that the network of whole ranges compares: two steps more than the bounds on either side.

    Where a range needs more than `NETWORK_MOST`, their steps are longer.
    """
    low, high = bounds
    step = max(NETWORK_STEP / farthest, (high - low) / (NETWORK_MOST - PADDED))
    count = math.ceil((high - low) / step - _ON_BOUND) + PADDED
    count += -count % DISPARITIES
    return Disparities((low + high) / 2 - step * (count - 1) / 2, step, count)


def are_in_windows(offsets: Float64Array, bounds: tuple[float, float]) -> bool:
    """Tell whether the range is so wide for views at `offsets` [n, 2] that a network improves its map in windows."""
    step = padded_disparities(bounds, network_reach(offsets, bounds)).step
    return bool(step * np.abs(offsets).max() > NETWORK_STEP * (1 + _ON_BOUND))


def view_sets(offsets: Float64Array, angle: float) -> Float64Array:
    """Sets of views at `offsets` [n, 2] that may see past an outline together, [m, n] of 1 and 0.

    The first set holds all views. The others hold the views within an angle (degrees) around the reference, in eight
    directions, with the views on the borders; sets that repeat others or are empty are left out.
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
