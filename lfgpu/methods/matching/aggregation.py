"""Aggregations: from the costs of single pixels to a map. Each is a class and a row of `AGGREGATIONS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from lfgpu.contract import Array
from lfgpu.methods.matching.base import Aggregation, Swept
from lfgpu.methods.matching.costs import noise_cost
from lfgpu.methods.matching.disparities import (
    NETWORK_STEP,
    WINDOW,
    are_in_windows,
    network_reach,
    padded_disparities,
)
from lfgpu.methods.matching.frame import Frame, Selection, SweptViews
from lfgpu.methods.matching.learned import Network, weights_of, weights_of_windows

_RIGHT = 0.07  # pixels per view step: the confidence is the probability of smaller errors


class SemiGlobal(Aggregation):
    """Semi-global matching (Hirschmüller 2008) through costs that are averaged over like pixels.

    With `at_edges`, surfaces end rather where the views as they are compared, smoothed if they have grain, have edges.
    """

    def __init__(self, views: SweptViews, *, at_edges: bool) -> None:
        frame, config = views.frame, views.frame.config
        self._frame, self._kernels, self._prior = frame, frame.kernels, frame.prior
        tuning = config.tuning.semi_global
        # Costs of the nearer surface reach as far into its corners as they are averaged; maps need more against noise.
        self._near = frame.like_pixels(tuning.window)
        factor, self._contrast = 1.0, tuning.contrast
        if not at_edges:
            factor, self._contrast = tuning.resweep_factor, tuning.resweep_contrast
        number, most_noisy = frame.arena.number, tuning.most_noisy
        self._small = number(lambda: frame.config.semi_global.small_penalty)
        self._large = number(lambda: factor * frame.config.semi_global.large_penalty)
        self._noise, self._most_noisy = number(lambda: noise_cost(frame.config)), most_noisy
        self._least = number(lambda: noise_cost(frame.config) / most_noisy)
        self._most = number(lambda: noise_cost(frame.config) * most_noisy**2)
        self._first = number(lambda: frame.disparities.first)
        self._costs = frame.arena.field("averaged costs", (frame.disparities.slices, *frame.size))
        self.evidence = self._costs, frame.arena.field("costs", (frame.disparities.slices, *frame.size))
        with frame.arena.scratch() as scratch:
            self._penalty_scale, self._workspace = scratch.fields(2, frame.size)

    def __call__(self, swept: Swept, disparity_out: Array) -> None:
        """See `Aggregation`. The sums over paths overwrite the volume."""
        volume, step = swept.volume, self._frame.disparities.step
        assert volume is not None
        self._near.average(volume, self._costs)
        self._scale_penalties()
        if swept.expect is not None:
            swept.expect(self._costs)
        self._kernels.semi_global(
            self._costs,
            self._frame.compared_image,
            self._penalty_scale,
            small=self._small,
            large=self._large,
            contrast=self._contrast,
            sum_out=volume,
        )
        self._kernels.winner_takes_all(
            volume, first=self._first, step=step, disparity_out=disparity_out, **self._frame.labels
        )

    def _scale_penalties(self) -> None:
        """Find the noise around each pixel, in units of the light field's, 1 to `most_noisy`.

        Where views differ more than elsewhere even at the disparity at which they agree best (grain, gloss), all
        differences of costs are larger by chance, and the penalties must be as well. The noise is the harmonic mean of
        the least costs in the window: a few pixels that no view shows well do not raise it.
        """
        kernels, noise, scale, workspace = self._kernels, self._noise, self._penalty_scale, self._workspace
        ones = self._prior.ones
        kernels.least_costs(self._costs, least_out=scale)
        kernels.clamp(scale, self._least, self._most, scale)
        kernels.divide(ones, scale, scale)
        self._prior.mean(scale, workspace)
        kernels.axpby(noise, workspace, 0.0, workspace, workspace)
        kernels.divide(ones, workspace, scale)
        kernels.clamp(scale, 1.0, self._most_noisy, scale)


class Learned(Aggregation):
    """The networks of `learned.py`, trained on generated light fields, over costs by angular sector of all used views.

    The first one compares a whole range. Where that takes more than `NETWORK_MOST` disparities, it looks at the views
    near the reference only, for which fewer suffice. A second network then compares a few disparities around that map
    in all views. They lie around facets of the map, so that a turned surface is level among them.
    """

    has_own_costs: ClassVar[bool] = True

    def __init__(self, views: SweptViews) -> None:
        frame = views.frame
        layout, arena = frame.layout, frame.arena
        self._frame, self._kernels, self._weights = frame, frame.kernels, weights_of(frame.config.weights)
        reach = network_reach(layout.offsets, frame.bounds)
        near = np.flatnonzero(np.abs(layout.offsets).max(1) <= reach).tolist()
        chosen = None if len(near) == layout.count else near
        selection = Selection(frame, "views near the reference", chosen, layout.subset(near), layout.dtype)
        planned = padded_disparities(frame.bounds, reach)
        self._step = planned.step

        def fits(bounds: tuple[float, float]) -> bool:
            is_same = network_reach(layout.offsets, bounds) == reach
            return is_same and replace(padded_disparities(bounds, reach), first=planned.first) == planned

        frame.fits.append(fits)
        with arena.scratch() as scratch:
            self._probability, self._deviation = scratch.fields(2, frame.size)
            with arena.scratch():  # of the second network, too
                self._network = Network(arena, self._weights, selection.layout, planned.count)
            self._windows = Windows(frame) if are_in_windows(layout.offsets, frame.bounds) else None
        self.image, self.factor = self._network.image, self._network.factor
        self._selection = selection
        self._lowest = arena.number(lambda: padded_disparities(frame.bounds, reach).first)
        self._first = arena.field("first of the network", frame.size)
        self.confidence, self.variance = (
            arena.field(f"{name} of the network", frame.size) for name in ("confidence", "variance")
        )

    def __call__(self, swept: Swept, disparity_out: Array) -> None:
        """See `Aggregation`."""
        assert self.confidence is not None
        assert self.variance is not None
        kernels, windows = self._kernels, self._windows
        self._network.load(*self._selection.of(*self._frame.used))
        outputs = {"disparity_out": disparity_out, "probability_out": self._probability}
        outputs["deviation_out"] = self._deviation
        kernels.fill(self._lowest, self._first)
        self._network(self._first, step=self._step, **outputs)
        step, weights = self._step, self._weights
        if windows is not None:
            step, weights = windows.step, windows.weights
            windows.begin(disparity_out, self._first)
            windows.network.load(*self._frame.used)
            windows.network(self._first, step=step, **outputs)
        kernels.judge_peak(
            self._probability,
            self._deviation,
            step=step,
            limit=_RIGHT,
            share=[float(weight) for weight in weights["share"]],
            spread=[float(weight) for weight in weights["spread"]],
            confidence_out=self.confidence,
            variance_out=self.variance,
        )


class Windows:
    """The network that compares a few disparities around a map, in all used views."""

    def __init__(self, frame: Frame) -> None:
        self._kernels, self.weights = frame.kernels, weights_of_windows()
        self.step = NETWORK_STEP / frame.layout.farthest
        """The distance of the disparities, pixels per view step."""
        self._ones = frame.prior.ones
        with frame.arena.scratch() as scratch:
            self._planes, self._apart = scratch.image((*frame.size, 4)), scratch.field(frame.size)
        with frame.arena.scratch():
            self.network = Network(frame.arena, self.weights, frame.layout, WINDOW)

    def begin(self, map_: Array, first_out: Array) -> None:
        """Find the first disparity of each pixel [y, x] around a map [y, x].

        Where the window around the facet would not hold the map, as on a thin bar, it lies around the map instead.
        """
        kernels, apart, half = self._kernels, self._apart, self.step * (WINDOW - 1) / 2
        kernels.planes(map_, planes_out=self._planes)
        kernels.facets(self._planes, facets_out=first_out)
        kernels.axpby(1.0, first_out, -1.0, map_, apart)
        kernels.multiply(apart, apart, apart)
        kernels.threshold(apart, half**2, apart)
        kernels.select(apart, map_, first_out, first_out)
        kernels.axpby(1.0, first_out, -half, self._ones, first_out)


AGGREGATIONS: Mapping[str, Callable[[SweptViews], Aggregation]] = {
    "semi-global, cut at edges": lambda views: SemiGlobal(views, at_edges=True),
    "semi-global": lambda views: SemiGlobal(views, at_edges=False),
    "learned": Learned,
}
"""Aggregations by name, each planned for the views of a sweep."""

FOLLOWING = "semi-global, cut at edges", "semi-global", "learned"
"""Aggregations whose numbers are all the arena's: a plan goes on with another range and noise."""
