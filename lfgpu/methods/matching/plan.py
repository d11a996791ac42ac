"""Matching: what every pixel of the reference view looks most like in the other views, with occlusions.

Four stages. `sweep` compares a row and a column of views with the reference at a row of disparities and finds the best
surface through these costs. What it compares is smoothed first, as far as the views have grain, and reduced views are
compared as well: both show faint texture that noise hides from single pixels. Partial view sets see past occluders.
`resweep` compares again, once or several times, each time with the views that see a pixel past the surface found so
far. What lies beside an outline looks like a part of what is nearer: its image gradient and its smoothed value are. So
the first surfaces are too large, and hide that place from itself. Later surfaces are nearly right, and what they hide
is widened by a pixel; what is a mere guess hides less (`guesses.py`). Gradients count for less in the last sweep, and
for nothing in those between first and last.
`align` makes the disparity continuous: Gauss-Newton steps on what the views that see a pixel have in common, and then
the plane through similar pixels on one surface. `boundaries` gives each pixel at a depth edge to the side whose colour
it has, and fills surfaces without texture from those around them.

Of large grids every other view is enough until the last step of the alignment: `swept_views`. Between the first and the
last sweep half of those are: `middle_views`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from lfgpu.contract import REDUCTION, WHITE, Array, Device, Float32Array, SweepCost
from lfgpu.data.layout import ViewLayout
from lfgpu.data.windows import window_min
from lfgpu.errors import LightFieldError
from lfgpu.methods.base import Callback, Work
from lfgpu.methods.matching.alignment_step import AlignmentStep
from lfgpu.methods.matching.boundaries import Boundaries
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.guesses import GuessedSurfaces
from lfgpu.methods.matching.hole_filling import HoleFilling
from lfgpu.methods.matching.judging import Judging
from lfgpu.methods.matching.noise import in_units_of, noise_of_views, smoothing_deviation
from lfgpu.methods.matching.reduced import ReducedSweep
from lfgpu.methods.matching.some_views import SomeViews
from lfgpu.methods.matching.sweep import (
    first_views,
    further_sweeps,
    labels,
    middle_views,
    noise_cost,
    planned_sweep,
    sweep_cost,
    swept_views,
    used_views,
)
from lfgpu.methods.matching.visible_sweep import VisibleSweep
from lfgpu.methods.measured import Measured
from lfgpu.methods.prior import UNLIKE_ANY, NonLocalMeans
from lfgpu.solvers.solution import Solution

_LEAST_CURVATURE = 1e-2  # over robust²: what holds a pixel where nothing but noise would move it
_LEAST_REDUCED = 2  # pixels, side of the smallest views that are worth comparing
_STILL = 1e-2  # what a pixel without any texture weighs in the mean of its window
_MOST_NOISY = 4.0  # in units of the noise: how much the least costs around a pixel raise the penalties there

_BESIDE = 1  # pixels beside an outline in another view that show what is nearer, too
_CONVERGED = 0.02  # pixels per view step, rms of the last step


class MatchingPlan:
    """Matching for light fields of one kind, with all memory allocated.

    Parameters
    ----------
    layout
        The layout of the views.
    measured
        The disparity range and the noise.
    config
        All parameters.
    device
        The device on which it runs. It takes two volumes of one float for each pixel and
        disparity, and what operations keep.
    """

    decided = "align"
    may_be_masked = False
    """Whether views may come with masks that the light field does not have."""

    def __init__(self, layout: ViewLayout, measured: Measured, config: MatchingConfig, device: Device) -> None:
        kernels = device.kernels
        assert measured.noise is not None  # this method measures it
        self._deviation = smoothing_deviation(measured.grain, config.sweep)
        self._noise = noise_of_views(measured.noise, measured.grain, config.sweep)
        config, bounds = in_units_of(measured.noise, config, grain=measured.grain), measured.disparity_range
        self._kernels, self._device, self._size = kernels, device, layout.size
        self._bounds, self._config, self._noise_cost = bounds, config, noise_cost(config.sweep)
        self._used, self._chosen = used_views(layout, config.sweep.views), None
        if len(self._used) < layout.count:
            layout = layout.subset(self._used)
            self._chosen = device.zeros_image(layout.shape, layout.dtype)
        self._reference, self._scale, self._farthest = layout.reference, layout.scale, layout.farthest
        shape, image = layout.shape, (*layout.size, layout.channels)
        self._offsets = device.field(layout.offsets)
        masks = layout.masks
        self._valid = None if masks is None else device.field(np.stack(masks))
        self._known = None if masks is None else device.field(masks[layout.reference])
        # Where a patch holds a pixel that the reference did not record, it is like no other patch.
        patch = config.prior.patch
        alike = None if masks is None else window_min(masks[layout.reference], patch)
        self._alike = None if alike is None else device.field(alike)
        self._far = None if layout.masks is None else device.field(np.full(layout.size, bounds[0]))
        self._unknown = None if layout.masks is None else device.field(np.full(layout.size, np.nan))
        held = config.hole_filling.stiffness * config.alignment.robust**2  # as strongly as one similar neighbour
        self._held = None if layout.masks is None else device.field(np.full(layout.size, held))
        self._image = device.zeros_image(image)
        self._prior = NonLocalMeans(image, config.prior, device)
        # Costs of what is nearer reach as far into its corners as they are averaged; maps need more against noise.
        self._near = self._prior
        if config.semi_global.window != config.prior.window:
            self._near = NonLocalMeans(image, replace(config.prior, window=config.semi_global.window), device)
        self._first, self._step, count = labels(bounds, layout.offsets, config.sweep)
        self._volume, self._smooth = (device.zeros((count, *layout.size)) for _ in range(2))
        # Every other view is enough for the first steps on large grids.
        swept = swept_views(layout.offsets, config.sweep.views)
        some, self._some = layout, None
        self._swept_offsets, nearest = self._offsets, device.zeros(shape[:3])
        self._swept_nearest = nearest
        if len(swept) < layout.count:
            some = layout.subset(swept)
            self._some = SomeViews(layout, swept, device, masked=self.may_be_masked)
            self._swept_offsets = device.field(some.offsets)
            self._swept_nearest = device.zeros((len(swept), *layout.size))
        self._swept_shape, self._swept_reference = (some.count, *shape[1:]), some.reference
        place = self._first, self._step, count
        self._compared, self._unit = self._image, layout.scale
        if self._deviation is not None:
            self._compared, self._unit = device.zeros_image(image), 1 / WHITE
            self._smoothed = device.zeros_image(self._swept_shape, np.uint16)
        self._resweeps = further_sweeps(some.offsets, config.sweep)
        self._few, few = None, some
        chosen = first_views(some, config.sweep.first_views)
        if len(chosen) < some.count:
            stored = None if self._deviation is None else np.uint16
            self._few = SomeViews(some, chosen, device, stored=stored, masked=self.may_be_masked)
            few = some.subset(chosen)
        self._few_shape, self._few_offsets = (few.count, *shape[1:]), few.offsets
        self._first_cost = sweep_cost(config.sweep, config.sweep.gradient_weight)
        self._last_cost = sweep_cost(config.sweep, config.sweep.resweep_gradient_weight)
        self._middle_cost = SweepCost(config.sweep.resweep_truncation, softness=self._last_cost.softness)
        self._sweep = planned_sweep(
            self._few_shape,
            self._few_offsets,
            place,
            config.sweep,
            device,
            scale=self._unit,
        )
        self._reduced = None
        if config.sweep.reduced_weight > 0 and min(layout.size) >= _LEAST_REDUCED * REDUCTION:
            # More than one further sweep mends what reduced views do to outlines, and gains from all they show.
            contrast = config.sweep.reduced_contrast if self._resweeps <= 1 else None
            self._reduced = ReducedSweep(few, place, config.sweep, device, scale=self._unit, contrast=contrast)
        self._middle = self._resweep = None
        self._reach = _BESIDE if self._resweeps > 1 else 0  # the first surface is too large as it is
        if self._resweeps:
            middle = middle_views(some.offsets, config.sweep.views)
            if self._resweeps > 1 and len(middle) < some.count:
                self._middle = self._visible_sweep(some, place, range(min(self._resweeps - 1, 2)), middle)
            reaches = (self._reach,) if self._middle is not None else range(min(self._resweeps, 2))
            self._resweep = self._visible_sweep(some, place, reaches)
        self._last_step = self._planned_step(shape, self._offsets, nearest)
        self._first_steps = self._last_step
        if self._some is not None:
            self._first_steps = self._planned_step(self._swept_shape, self._swept_offsets, self._swept_nearest)
        self._swept, self._aligned, self.disparity, self.confidence = (device.zeros(layout.size) for _ in range(4))
        """`disparity` and `confidence` are the results, fields [y, x]."""
        self._matched = device.zeros(layout.size) if self._resweeps else self._swept
        self._hole_filling = HoleFilling(layout.size, self._prior, config.hole_filling)
        self._curvature, self._slope, self._certainty = (device.zeros(layout.size) for _ in range(3))
        self._workspace, self._penalty_scale = (device.zeros(layout.size) for _ in range(2))
        self._boundaries = Boundaries(
            kernels, config.boundaries, step=config.boundaries.step / self._farthest, workspace=self._workspace
        )
        # What earlier stages needed is free when the map is judged.
        needed = self._curvature, self._certainty, self._slope, self._workspace, self._penalty_scale
        free = (*needed, device.zeros(layout.size))
        self._judging = Judging(
            kernels,
            kind=config.sweep.kind,
            bounds=bounds,
            step=self._step,
            unit=self._noise_cost,
            workspace=free,
            variance=device.zeros(layout.size),
        )
        self._first_evidence = device.zeros(layout.size) if self._resweeps else None
        self._later_evidence = free[-1]
        self._guesses = None
        if self._resweeps and config.sweep.ambiguity < 1:
            self._guesses = GuessedSurfaces(
                kernels,
                share=config.sweep.ambiguity,
                step=self._step,
                count=count,
                tolerance=config.sweep.tolerance / self._farthest,
                ones=self._prior.ones,
                zeros=device.zeros(layout.size),
                workspace=free[:-1],
            )
        self._moves = [device.scalar(0.0) for _ in range(config.alignment.iterations)]
        self._trust = device.scalar(0.0)
        self._steps = len(self._moves)

    def stages(self, views: Array) -> dict[str, Work]:
        """What there is to do for `views` [n, y, x, c], as stored, by name and in order."""
        again: dict[str, Work] = {"resweep": self._compare_visible} if self._resweeps else {}
        return {
            "sweep": lambda _: self._compare(views),
            **again,
            "align": self._improve,
            "boundaries": self._finish,
        }

    def check(self, name: str) -> None:
        """LightFieldError, with the light field's name, if nothing came of the last run; waits for the device."""
        if not self._kernels.number(self._trust) > 0:
            raise LightFieldError(
                f"{name}: no pixel shows anything that other views show as well: the views have no texture, are "
                "masked, or the disparity range is wrong; give another one."
            )

    def is_finite(self) -> bool:
        """Whether the last run met finite numbers only; waits for the device."""
        return bool(np.isfinite(self._kernels.number(self._moves[0])))

    def maps(self) -> dict[str, Float32Array]:
        """The map after each stage, float32 [y, x], NaN where it is undefined; waits for the device."""
        again = {"resweep": self._matched} if self._resweeps else {}
        kept = {"sweep": self._swept, **again, "align": self._aligned, "boundaries": self.disparity}
        found = {name: self._kernels.numpy(field).astype(np.float32) for name, field in kept.items()}
        if self._known is None:
            return found
        known = self._kernels.numpy(self._known) > 0
        return {name: np.where(known, map_, np.float32(np.nan)) for name, map_ in found.items()}

    def solution(self) -> Solution:
        """How the alignment went: its trace is the root mean square step of each iteration, in pixels per view step."""
        height, width = self._size
        trace = tuple(math.sqrt(self._kernels.number(move) / (height * width)) for move in self._moves)
        return Solution(
            converged=trace[-1] <= _CONVERGED,
            status=f"Noise between views: {self._noise:.2g} of full intensity. The last step of the "
            f"alignment moved pixels by {trace[-1]:.2g} px (rms).",
            iterations=len(trace),
            evaluations=len(trace),
            trace=trace,
        )

    def _compare(self, views: Array) -> None:
        self._load(views)
        self._sweep.by_view_sets(self._first_cost, self._volume)
        if self._reduced is not None:
            self._reduced.add(self._volume)
        self._find_surface(self._swept)
        if self._first_evidence is not None:
            self._judging.evidence(self._smooth, self._volume, self._first_evidence)

    def _load(self, views: Array, *, first: bool = True) -> None:
        """Take the views of a frame [n, y, x, c]; the first sweep gets its share only if it is to come (`first`)."""
        kernels = self._kernels
        if self._chosen is not None:
            kernels.line_of_views(views, self._used, vertical=False, epis_out=self._chosen)
            views = self._chosen
        kernels.intensities(
            views, self._reference, self._valid, scale=self._scale, fill=UNLIKE_ANY, image_out=self._image
        )
        self._prior.load(self._image)
        if self._near is not self._prior:
            self._near.load(self._image)
        self._last_step.load(self._image, views, self._valid)
        valid = self._valid
        if self._some is not None:
            views, valid = self._some.of(views, valid)
            self._first_steps.load(self._image, views, valid)
        if self._deviation is not None:
            kernels.smooth_views(views, valid, scale=self._scale, deviation=self._deviation, views_out=self._smoothed)
            views = self._smoothed
            kernels.intensities(
                views, self._swept_reference, valid, scale=self._unit, fill=UNLIKE_ANY, image_out=self._compared
            )
        if self._resweep is not None:
            self._resweep.load(self._compared, views, valid)
        if not first:
            return
        if self._middle is not None:
            self._middle.load(self._compared, views, valid)
        if self._few is not None:
            views, valid = self._few.of(views, valid)
        self._sweep.load(self._compared, views, valid)
        if self._reduced is not None:
            self._reduced.load(views, valid)

    def _compare_visible(self, _: Callback | None) -> None:
        assert self._resweep is not None  # there is no such stage otherwise
        middle = self._middle or self._resweep
        surface, reach = self._hiding(self._swept, self._first_evidence), 0
        for _again in range(self._resweeps - 1):
            middle(surface, self._volume, reach=reach, cost=self._middle_cost)
            self._find_surface(self._matched, again=True)
            surface, reach = self._hiding(self._matched), _BESIDE
        self._resweep(surface, self._volume, reach=reach, cost=self._last_cost)
        self._find_surface(self._matched, again=True)

    def _hiding(self, surface: Array, evidence: Array | None = None) -> Array:
        """What of the surface that was found last hides anything; the next call and the alignment overwrite it."""
        if self._guesses is None:
            return surface
        if evidence is None:
            evidence = self._later_evidence
            self._judging.evidence(self._smooth, self._volume, evidence)
        self._guesses.run(evidence, surface, self._aligned)
        return self._aligned

    def _find_surface(self, disparity_out: Array, *, again: bool = False) -> None:
        """From costs to the map of the best surface through them, after further sweeps `again`; both volumes change.

        Edges of the image are those of the views as they are compared, smoothed if they have grain: noise is no edge.
        """
        semi_global = self._config.semi_global
        factor, contrast = 1.0, semi_global.contrast
        if again:
            factor, contrast = semi_global.resweep_factor, semi_global.resweep_contrast
        self._near.average(self._volume, self._smooth)
        self._weigh_penalties()
        self._expect(self._smooth)
        self._kernels.semi_global(
            self._smooth,
            self._compared,
            self._penalty_scale,
            small=semi_global.small_penalty,
            large=factor * semi_global.large_penalty,
            contrast=contrast,
            sum_out=self._volume,
        )
        self._kernels.winner_takes_all(self._volume, first=self._first, step=self._step, disparity_out=disparity_out)
        if self._known is not None:  # what the reference did not record hides nothing
            self._kernels.select(self._known, disparity_out, self._far, disparity_out)

    def _improve(self, callback: Callback | None) -> None:
        """Gauss-Newton steps on the sums over each pixel's surface around it, and then the plane through that."""
        kernels, config, map_, workspace = self._kernels, self._config.alignment, self._aligned, self._workspace
        longest = config.longest_step / self._farthest
        kernels.copy(self._matched, map_)
        for iteration, moved in enumerate(self._moves[: self._steps], 1):
            step = self._last_step if iteration == self._steps else self._first_steps
            step(map_, self._curvature, self._slope)
            self._on_surface(self._slope, self._curvature, _LEAST_CURVATURE * config.robust**2, workspace)
            kernels.clamp(workspace, -longest, longest, workspace)
            kernels.dot(workspace, workspace, moved)
            kernels.axpby(1.0, map_, 1.0, workspace, map_)
            kernels.clamp(map_, *self._bounds, map_)
            if iteration == self._steps:
                self._put_back(map_, config.reach * self._step)
            self._weigh_texture(config.stiffness * config.robust**2)
            support = config.support / self._farthest
            self._prior.plane(map_, self._certainty, support=support, ridge=config.ridge, plane_out=workspace)
            kernels.copy(workspace, map_)
            if callback is not None:
                callback(iteration, math.sqrt(kernels.number(moved) / (self._size[0] * self._size[1])))
        kernels.axpby(1.0, self._certainty, -_STILL, self._prior.ones, workspace)
        kernels.dot(workspace, self._prior.ones, self._trust)

    def _put_back(self, map_: Array, reach: float) -> None:
        """Pixels that are farther than `reach` from where they were matched return there.

        The smooth shading of a glossy surface moves with what is mirrored in it, not with the surface. It draws pixels
        away from the surface, a little farther in every step; matching is right there to about one disparity.
        """
        kernels, workspace = self._kernels, self._workspace
        kernels.axpby(1.0, map_, -1.0, self._matched, workspace)
        kernels.multiply(workspace, workspace, workspace)
        kernels.threshold(workspace, reach**2, workspace)
        kernels.select(workspace, self._matched, map_, map_)

    def _finish(self, _: Callback | None) -> None:
        self._complete()
        self._leave_unknown()

    def _leave_unknown(self) -> None:
        """NaN where the reference recorded nothing. Until here they hold a number, for their neighbours' sums."""
        if self._known is not None:
            self._kernels.select(self._known, self.disparity, self._unknown, self.disparity)

    def _complete(self) -> None:
        """Outlines where the colours have them, and surfaces without texture as what is around them goes on."""
        config = self._config
        self._boundaries.run(self._image, self._aligned, self.disparity)
        if self._alike is not None:  # what is like nothing has nothing to be filled from, and is left as it is
            self._kernels.select(self._alike, self._curvature, self._held, self._curvature)
        self._hole_filling.run(
            self.disparity,
            self._curvature,
            noise=config.alignment.robust**2,
            support=config.alignment.support / self._farthest,
        )
        self._kernels.clamp(self.disparity, *self._bounds, self.disparity)
        self._judge()

    def _weigh_penalties(self) -> None:
        """penalty_scale = the noise around each pixel, in units of the light field's, 1 to _MOST_NOISY.

        Where views differ more than elsewhere even at the disparity at which they agree best (grain, gloss), all
        differences of costs are larger by chance, and the penalties must be as well. The noise is the harmonic mean of
        the least costs in the window: a few pixels that no view shows well do not raise it.
        """
        kernels, noise, scale, workspace = self._kernels, self._noise_cost, self._penalty_scale, self._workspace
        kernels.least_costs(self._smooth, least_out=scale)
        kernels.clamp(scale, noise / _MOST_NOISY, noise * _MOST_NOISY**2, scale)
        kernels.divide(self._prior.ones, scale, scale)
        self._prior.mean(scale, workspace)
        kernels.axpby(noise, workspace, 0.0, workspace, workspace)
        kernels.divide(self._prior.ones, workspace, scale)
        kernels.clamp(scale, 1.0, _MOST_NOISY, scale)

    def _expect(self, costs: Array) -> None:
        """For those who know something about the surface beforehand: change the costs [l, y, x] of its disparities."""

    def _judge(self) -> None:
        self._judging.run(self._smooth, self._volume, self.disparity, self._unhidden_evidence(), self.confidence)
        if self._known is not None:
            self._kernels.multiply(self.confidence, self._known, self.confidence)

    def _unhidden_evidence(self) -> Array | None:
        """That of the sweep of this frame in which no surface hid anything, if another one followed."""
        return self._first_evidence

    def features(self) -> dict[str, Float32Array]:
        """What the confidence of the last run was made of, float32 [y, x] by name; waits for the device."""
        return self._judging.features()

    def uncertainty(self) -> Float32Array:
        """The standard deviation of the disparity, float32 [y, x], NaN where it is undefined; waits for the device."""
        deviation = self._judging.deviation()
        if self._known is not None:
            deviation[self._kernels.numpy(self._known) <= 0] = np.nan
        return deviation

    def _visible_sweep(
        self,
        layout: ViewLayout,
        place: tuple[float, float, int],
        reaches: Collection[int],
        chosen: Sequence[int] | None = None,
    ) -> VisibleSweep:
        """A further sweep over the views of a layout, or over those that are chosen."""
        kernels, device, config = self._kernels, self._device, self._config.sweep
        some, nearest = None, self._swept_nearest
        if chosen is not None:
            stored = None if self._deviation is None else np.uint16
            some = SomeViews(layout, chosen, device, stored=stored, masked=self.may_be_masked)
            layout, nearest = layout.subset(chosen), device.zeros((len(chosen), *self._size))
        shape = (layout.count, *self._swept_shape[1:])
        sweep = planned_sweep(
            shape,
            layout.offsets,
            place,
            config,
            device,
            scale=self._unit,
        )
        return VisibleSweep(sweep, shape, device.field(layout.offsets), nearest, kernels, reaches=reaches, some=some)

    def _planned_step(self, shape: Sequence[int], offsets: Array, nearest: Array) -> AlignmentStep:
        return AlignmentStep(
            shape,
            offsets,
            nearest,
            self._kernels,
            scale=self._scale,
            config=self._config.alignment,
            tolerance=self._config.sweep.tolerance / self._farthest,
        )

    def _weigh_texture(self, stiffness: float) -> None:
        """certainty = curvature / (curvature + stiffness) + a little, so that where nothing is certain means exist."""
        kernels, ones = self._kernels, self._prior.ones
        kernels.axpby(1.0, self._curvature, stiffness, ones, self._certainty)
        kernels.divide(self._curvature, self._certainty, self._certainty)
        kernels.axpby(1.0, self._certainty, _STILL, ones, self._certainty)

    def _on_surface(self, numerator: Array, denominator: Array, floor: float, ratio_out: Array) -> None:
        self._prior.ratio(
            self._aligned,
            numerator,
            denominator,
            support=self._config.alignment.support / self._farthest,
            floor=floor,
            ratio_out=ratio_out,
        )
