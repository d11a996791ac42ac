"""Costs: how far views differ from the reference view at each disparity. A cost is a row of `COSTS`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from lfgpu.contract import REDUCTION, WHITE, Array, PlaneSweep, SweepCost, ViewSets
from lfgpu.methods.matching.base import Cost
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.disparities import view_sets
from lfgpu.methods.matching.frame import Frame, Selection, SweptViews
from lfgpu.methods.prior import UNLIKE_ANY

_BESIDE = 1  # reduced pixels from an edge that are beside it
_SEVERAL = 2  # further sweeps mend the outlines that reduced views blur
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

    They are reduced to one pixel for each REDUCTION x REDUCTION, and swept at the same disparities. Faint texture shows
    in them, and noise does not.
    """

    def __init__(self, views: SweptViews, cost: SweepCost) -> None:
        super().__init__(views, cost)
        frame, layout, tuning = views.frame, views.layout, views.frame.config.tuning.sweep
        self._reduced: PlaneSweep | None = None
        if not tuning.reduced_weight > 0 or min(layout.size) < _LEAST_REDUCED * REDUCTION:
            return
        arena, device, (height, width) = frame.arena, frame.arena.device, (side // REDUCTION for side in layout.size)
        small = replace(layout, size=(height, width), offsets=layout.offsets / REDUCTION)
        self._kernels, self._reference, self._scale = frame.kernels, layout.reference, frame.scale
        self._weight = tuning.reduced_weight
        # Beside an outline, many pixels of the farther side look like a part of the nearer one.
        self._contrast = tuning.reduced_contrast if frame.config.sweep.resweeps < _SEVERAL else None
        self._shares = device.field(np.ones(small.size))
        self._views = arena.image("reduced views", small.shape, np.uint16)
        self._image = arena.image("reduced image", small.shape[1:])
        self._valid = arena.field("reduced masks", small.shape[:3])
        self._volume = arena.field("reduced costs", (frame.disparities.slices, *small.size))
        sets = ViewSets(
            device.field(small.offsets),
            device.field(view_sets(small.offsets, tuning.view_set_angle)),
            preference=tuning.view_set_penalty,
            tolerance=0.0,  # nothing hides anything
            least=1,
        )
        self._reduced = frame.kernels.plane_sweep(small.shape, sets, frame.disparities, scale=1 / WHITE)
        frame.moving.append(self._reduced)
        self._selection = Selection(frame, "views to be reduced", views.chosen, layout, frame.stored)
        frame.on_load(self._load)

    def _load(self, _: Array, views: Array, valid: Array | None) -> None:
        """Reduce some of the compared views [n, y, x, c], as stored, with their masks [n, y, x]."""
        views, valid = self._selection.of(views, valid)
        kernels, kept = self._kernels, self._valid if valid is not None else None
        kernels.reduce_views(views, valid, scale=self._scale, views_out=self._views, valid_out=kept)
        kernels.intensities(self._views, self._reference, kept, scale=1 / WHITE, fill=UNLIKE_ANY, image_out=self._image)
        assert self._reduced is not None
        self._reduced.load(self._image, self._views, kept)
        if self._contrast is not None:
            kernels.edge_weights(self._image, contrast=self._contrast, reach=_BESIDE, weights_out=self._shares)

    def by_view_sets(self, volume_out: Array) -> None:
        """See `Cost`."""
        super().by_view_sets(volume_out)
        if self._reduced is not None:
            self._reduced.by_view_sets(self._cost, self._volume)
            self._kernels.add_reduced(self._volume, self._shares, weight=self._weight, volume_inout=volume_out)


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


def _followed(frame: Frame, cost: Callable[[MatchingConfig], SweepCost]) -> SweepCost:
    """Return a cost whose softness follows the noise."""
    planned = cost(frame.config)
    return (
        replace(planned, softness=frame.arena.number(lambda: softness(frame.config))) if planned.softness else planned
    )


COSTS: Mapping[str, Callable[[SweptViews], Cost]] = {
    "gradients, reduced views": lambda views: WithReducedViews(views, _followed(views.frame, first_cost)),
    "intensities": lambda views: PlaneSweepCost(views, _followed(views.frame, middle_cost)),
    "few gradients": lambda views: PlaneSweepCost(views, _followed(views.frame, last_cost)),
}
"""Costs by name, each planned for the views of a sweep."""

FOLLOWING = "gradients, reduced views", "intensities", "few gradients"
"""Costs whose numbers are all the arena's: a plan goes on with another noise."""
