"""Aggregations: from the costs of single pixels to a map. Each is a class and a row of `AGGREGATIONS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import ClassVar

from lfgpu.contract import Array, Disparities
from lfgpu.methods.matching.base import Aggregation, Swept
from lfgpu.methods.matching.costs import noise_cost
from lfgpu.methods.matching.disparities import padded_disparities
from lfgpu.methods.matching.frame import SweptViews
from lfgpu.methods.matching.learned import Network, weights_of

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
    """The network of `learned.py`, trained on generated light fields, over costs by angular sector."""

    has_own_costs: ClassVar[bool] = True

    def __init__(self, views: SweptViews) -> None:
        frame, layout = views.frame, views.layout

        def compared(bounds: tuple[float, float]) -> Disparities:
            return padded_disparities(bounds, layout.farthest, frame.config.sweep)

        planned = compared(frame.bounds)
        self._kernels, self._step = frame.kernels, planned.step
        frame.fits.append(lambda bounds: replace(compared(bounds), first=planned.first) == planned)
        self._weights = weights_of(frame.config.weights)
        with frame.arena.scratch() as scratch:
            self._probability, self._deviation = scratch.fields(2, frame.size)
            self._network = Network(frame.arena, self._weights, layout, planned.count)
        self.image, self.factor = self._network.image, self._network.factor
        views.on_load(lambda *_: self._network.load(*frame.thinned))
        self._lowest = frame.arena.number(lambda: compared(frame.bounds).first)
        self._first = frame.arena.field("first of the network", frame.size)
        self.confidence, self.variance = (
            frame.arena.field(f"{name} of the network", frame.size) for name in ("confidence", "variance")
        )

    def __call__(self, swept: Swept, disparity_out: Array) -> None:
        """See `Aggregation`."""
        assert self.confidence is not None
        assert self.variance is not None
        self._kernels.fill(self._lowest, self._first)
        self._network(
            self._first,
            step=self._step,
            disparity_out=disparity_out,
            probability_out=self._probability,
            deviation_out=self._deviation,
        )
        self._kernels.judge_peak(
            self._probability,
            self._deviation,
            step=self._step,
            limit=_RIGHT,
            share=[float(weight) for weight in self._weights["share"]],
            spread=[float(weight) for weight in self._weights["spread"]],
            confidence_out=self.confidence,
            variance_out=self.variance,
        )


AGGREGATIONS: Mapping[str, Callable[[SweptViews], Aggregation]] = {
    "semi-global, cut at edges": lambda views: SemiGlobal(views, at_edges=True),
    "semi-global": lambda views: SemiGlobal(views, at_edges=False),
    "learned": Learned,
}
"""Aggregations by name, each planned for the views of a sweep."""

FOLLOWING = "semi-global, cut at edges", "semi-global", "learned"
"""Aggregations whose numbers are all the arena's: a plan goes on with another range and noise."""
