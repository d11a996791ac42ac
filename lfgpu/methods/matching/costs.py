"""Costs: how far views differ from the reference view at each disparity. A cost is a row of `COSTS`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from lfgpu.contract import REDUCTION, Array, SweepCost
from lfgpu.methods.matching.base import Cost
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.frame import SweptViews
from lfgpu.methods.matching.reduced import ReducedViews

_LEAST_REDUCED = 2  # pixels: smallest side of reduced views that are worth comparing


class PlaneSweepCost:
    """The cost of a plane sweep, which `lfgpu.contract.PlaneSweep` defines."""

    def __init__(self, views: SweptViews, cost: SweepCost) -> None:
        self._sweep, self._cost = views.sweep, cost

    def by_view_sets(self, volume_out: Array) -> None:
        """See `Cost`."""
        self._sweep.by_view_sets(self._cost, volume_out)

    def by_visibility(self, nearest: Array, volume_out: Array) -> None:
        """See `Cost`."""
        self._sweep.by_visibility(nearest, self._cost, volume_out)


class WithReducedViews(PlaneSweepCost):
    """The cost of a plane sweep, and in the sum over view sets the cost of reduced views as well.

    Faint texture shows in views that are reduced, and noise does not.
    """

    def __init__(self, views: SweptViews, cost: SweepCost) -> None:
        super().__init__(views, cost)
        self._reduced = None
        if views.frame.config.tuning.sweep.reduced_weight > 0 and min(views.layout.size) >= _LEAST_REDUCED * REDUCTION:
            self._reduced = ReducedViews(views, cost)

    def by_view_sets(self, volume_out: Array) -> None:
        """See `Cost`."""
        super().by_view_sets(volume_out)
        if self._reduced is not None:
            self._reduced.add(volume_out)


def first_cost(config: MatchingConfig) -> SweepCost:
    """Return the cost of intensities and gradients: cameras may differ in brightness."""
    tuning = config.tuning.sweep
    return SweepCost(tuning.truncation, tuning.gradient_weight, tuning.gradient_truncation, softness(config))


def middle_cost(config: MatchingConfig) -> SweepCost:
    """Return the cost of intensities alone: beside an outline the gradient is that of the nearer surface."""
    return SweepCost(config.tuning.sweep.resweep_truncation, softness=softness(config))


def last_cost(config: MatchingConfig) -> SweepCost:
    """Return the cost of intensities and, with less weight, gradients."""
    tuning = config.tuning.sweep
    return SweepCost(tuning.truncation, tuning.resweep_gradient_weight, tuning.gradient_truncation, softness(config))


def softness(config: MatchingConfig) -> float:
    """Return the difference in intensity beyond which differences count by their square root."""
    return config.tuning.sweep.softness * config.sweep.noise


def noise_cost(config: MatchingConfig) -> float:
    """Compute the cost of a difference in intensity as large as the noise, if gradients do not differ."""
    s, noise = config.tuning.sweep.softness, config.sweep.noise
    return 2 * s * noise * (math.sqrt(1 + 1 / s) - 1) if s else noise


COSTS: Mapping[str, Callable[[SweptViews], Cost]] = {
    "gradients, reduced views": lambda views: WithReducedViews(views, first_cost(views.frame.config)),
    "intensities": lambda views: PlaneSweepCost(views, middle_cost(views.frame.config)),
    "few gradients": lambda views: PlaneSweepCost(views, last_cost(views.frame.config)),
}
"""Costs by name, each planned for the views of a sweep."""
