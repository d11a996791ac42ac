"""Matching: what every pixel of the reference view looks most like in the other views, with occlusions.

Four stages. `sweep` compares the views with the reference at a row of disparities, by apertures that see past
occluders, and finds the best surface through these costs. `match` compares again, now only with views that see a pixel
past the surface that has been found. `align` leaves the row of disparities behind: Gauss-Newton steps on what the views
that see a pixel have in common, taken together over pixels that look alike and lie on one surface. `settle` gives
pixels at outlines to the side that they show more of, and carries what is known into surfaces without texture.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from lfgpu.config import AlignmentConfig, Config, MatchingConfig, OutlinesConfig, PriorConfig, SweepConfig
from lfgpu.errors import LightFieldError
from lfgpu.filling import Filling
from lfgpu.lightfield import LightField
from lfgpu.method import Callback, Stage
from lfgpu.prior import UNLIKE_ANY, NonLocalMeans
from lfgpu.solvers.solution import Solution
from lfgpu.types import Array, Float32Array, Float64Array, KernelSet, PlaneSweep

_Stage = TypeVar("_Stage", SweepConfig, MatchingConfig, AlignmentConfig, OutlinesConfig, PriorConfig)

_DIRECTIONS = 8  # in which some of the views lie
_LEAST_CURVATURE = 1e-3  # over robust²: no division by 0 where there is no texture
_STILL = 1e-2  # what a pixel without any texture weighs in the mean of its window

_FEWEST = 4  # views beside the reference that a pattern must have
_ON_LINE = 1e-3  # view steps
_SAMPLE = 256  # pixels, side of what the noise is measured in
_USUAL_NOISE = 0.004  # intensity: what the defaults are meant for
_LEAST_NOISE, _MOST_NOISE = 0.7, 5.0  # in units of that
_DOUBT = 0.22  # pixels per view step, rms, that make a pixel as likely off by more than 0.07 as not
_CONVERGED = 0.02  # pixels per view step, rms of the last step


class Matching:
    """The method of the presets "accurate" and "fast" for light fields of one kind.

    Parameters
    ----------
    lf
        A light field of that kind: its cameras, size, stored type, masks and reference view count. Of its views only
        the noise does, unless `config.sweep.noise` gives it.
    bounds
        (low, high) of the disparities, pixels per view step.
    config
        `prior`, `sweep`, `matching`, `alignment`, `outlines` and `filling` count.
    kernels, device
        Where it is done; it takes two volumes of one float a pixel and disparity, and what the kernels keep.
    """

    decided = "align"

    def __init__(
        self, lf: LightField, bounds: tuple[float, float], config: Config, kernels: KernelSet, device: str
    ) -> None:
        noise = config.sweep.noise or measured_noise(lf, bounds, config.sweep, kernels, device)
        config = in_units_of(noise, config)
        self._kernels, self._bounds, self._config = kernels, bounds, config
        self._twice = config.sweep.occlusions == "twice"
        self._used, self._chosen = used_views(lf, config.sweep.views), None
        if len(self._used) < len(lf.views):
            lf = lf.subset(self._used)
            self._chosen = kernels.zeros_image(lf.views.shape, device, lf.views.dtype)
        self._reference, self._scale, self._farthest = lf.reference_index, lf.scale, farthest(lf.offsets)
        shape, image = (len(lf.views), *lf.size, lf.channels), (*lf.size, lf.channels)
        self._offsets = kernels.field(lf.offsets, device)
        self._valid = None if lf.valid is None else kernels.field(lf.valid, device)
        self._known = None if lf.valid is None else kernels.field(lf.valid[lf.reference_index], device)
        self._far = None if lf.valid is None else kernels.field(np.full(lf.size, bounds[0]), device)
        held = config.filling.stiffness * config.alignment.robust**2  # as strongly as one neighbour that looks alike
        self._held = None if lf.valid is None else kernels.field(np.full(lf.size, held), device)
        self._image = kernels.zeros_image(image, device)
        self._prior = NonLocalMeans(image, config.prior, kernels, device)
        # Costs of what is nearer reach as far into its corners as they are averaged; maps need more against noise.
        self._near = self._prior
        if config.matching.window != config.prior.window:
            self._near = NonLocalMeans(image, replace(config.prior, window=config.matching.window), kernels, device)
        self._first, self._step, count = labels(bounds, lf.offsets, config.sweep)
        self._volume, self._smooth = (kernels.zeros((count, *lf.size), device) for _ in range(2))
        self._nearest = kernels.zeros(shape[:3], device)
        self._sweep = _planned_sweep(lf, (self._first, self._step, count), config.sweep, kernels, device)
        self._hiding = kernels.nearest_surface(shape, self._offsets, reach=0) if self._twice else None
        self._hiding_beside = kernels.nearest_surface(shape, self._offsets, reach=1)
        self._align = kernels.alignment(
            shape,
            self._offsets,
            scale=lf.scale,
            gradient_weight=config.alignment.gradient_weight,
            robust=config.alignment.robust,
            tolerance=config.sweep.tolerance / self._farthest,
        )
        self._swept, self._aligned, self.disparity, self.confidence = (kernels.zeros(lf.size, device) for _ in range(4))
        """`disparity` and `confidence` are the results, fields [y, x]."""
        self._matched = kernels.zeros(lf.size, device) if self._twice else self._swept
        self._filling = Filling(lf.size, self._prior, config.filling)
        self._curvature, self._slope, self._certainty, self._room = (kernels.zeros(lf.size, device) for _ in range(4))
        self._moves = [kernels.scalar(0.0, device) for _ in range(config.alignment.iterations)]
        self._trust, self._size = kernels.scalar(0.0, device), lf.size
        self._steps = len(self._moves)

    def stages(self, views: Array) -> dict[str, Stage]:
        """What there is to do for `views` [n, y, x, c], as stored, by name and in order."""
        match: dict[str, Stage] = {"match": self._compare_seen} if self._twice else {}
        return {"sweep": lambda _: self._compare(views), **match, "align": self._improve, "settle": self._settle}

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
        """The map after each stage, float32 [y, x]; waits for the device."""
        matched = {"matched": self._matched} if self._twice else {}
        kept = {"swept": self._swept, **matched, "aligned": self._aligned, "settled": self.disparity}
        return {name: self._kernels.numpy(field).astype(np.float32) for name, field in kept.items()}

    def solution(self) -> Solution:
        """How the alignment went: its trace is the root mean square step of each iteration, in pixels per view step."""
        height, width = self._size
        trace = tuple(math.sqrt(self._kernels.number(move) / (height * width)) for move in self._moves)
        return Solution(
            converged=trace[-1] <= _CONVERGED,
            status=f"Views that agree differ by {self._config.sweep.noise:.2g} in intensity. Alignment: the last of "
            f"{len(trace)} iterations moved pixels by {trace[-1]:.2g} px (rms).",
            iterations=len(trace),
            evaluations=len(trace),
            trace=trace,
        )

    def _compare(self, views: Array) -> None:
        self._load(views)
        self._sweep.apertures(self._volume)
        self._find_surface(self._swept)

    def _load(self, views: Array) -> None:
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
        self._sweep.load(self._image, views, self._valid)
        self._align.load(self._image, views, self._valid)

    def _compare_seen(self, _: Callback | None) -> None:
        assert self._hiding is not None  # there is no such stage otherwise
        self._hiding(self._swept, self._nearest)
        self._sweep.seen(self._nearest, self._volume)
        self._find_surface(self._matched)

    def _find_surface(self, disparity_out: Array) -> None:
        """From costs to the map of the best surface through them; both volumes change."""
        matching = self._config.matching
        self._near.average(self._volume, self._smooth)
        self._expect(self._smooth)
        self._kernels.semi_global(
            self._smooth,
            self._image,
            small=matching.small_step,
            large=matching.large_step,
            contrast=matching.contrast,
            sum_out=self._volume,
        )
        self._kernels.lowest(self._volume, first=self._first, step=self._step, disparity_out=disparity_out)
        if self._known is not None:  # what the reference did not record hides nothing
            self._kernels.choose(self._known, disparity_out, self._far, disparity_out)

    def _improve(self, callback: Callback | None) -> None:
        """Gauss-Newton steps on the sums over each pixel's surface around it, and then its mean."""
        kernels, config, map_, room = self._kernels, self._config.alignment, self._aligned, self._room
        longest = config.longest_step / self._farthest
        kernels.copy(self._matched, map_)
        for iteration, moved in enumerate(self._moves[: self._steps], 1):
            # Beside an edge in another view, what is seen there is mixed with what is nearer: one pixel is left out.
            self._hiding_beside(map_, self._nearest)
            self._align(map_, self._nearest, self._curvature, self._slope)
            self._on_surface(self._slope, self._curvature, _LEAST_CURVATURE * config.robust**2, room)
            kernels.clamp(room, -longest, longest, room)
            kernels.dot(room, room, moved)
            kernels.axpby(1.0, map_, 1.0, room, map_)
            kernels.clamp(map_, *self._bounds, map_)
            self._weigh_texture(config.stiffness * config.robust**2)
            kernels.multiply(map_, self._certainty, room)
            self._on_surface(room, self._certainty, 0.0, self._slope)
            kernels.copy(self._slope, map_)
            if callback is not None:
                callback(iteration, math.sqrt(kernels.number(moved) / (self._size[0] * self._size[1])))
        kernels.axpby(1.0, self._certainty, -_STILL, self._prior.ones, room)
        kernels.dot(room, self._prior.ones, self._trust)

    def _settle(self, _: Callback | None) -> None:
        """Outlines where the colours have them, and surfaces without texture as what is around them goes on."""
        config = self._config
        self._kernels.unmix(
            self._image,
            self._aligned,
            step=config.sweep.tolerance / self._farthest,
            contrast=config.outlines.contrast,
            share=config.outlines.share,
            disparity_out=self.disparity,
        )
        if self._known is not None:  # what the reference did not record is like nothing, and is left as it is
            self._kernels.choose(self._known, self._curvature, self._held, self._curvature)
        self._filling.run(
            self.disparity,
            self._curvature,
            noise=config.alignment.robust**2,
            support=config.alignment.support / self._farthest,
        )
        self._kernels.clamp(self.disparity, *self._bounds, self.disparity)
        self._judge()

    def _expect(self, costs: Array) -> None:
        """For those who know something about the surface beforehand: change the costs [l, y, x] of its disparities."""

    def _judge(self) -> None:
        """confidence = 1 / (1 + odds), odds = (1 - c) / 2 + (s / _DOUBT)² being those of a pixel being off.

        c is the mean certainty of the pixel's window, so that odds are 1 to 2 where it has no texture. s² is the mean
        of (matched_q - disparity_p)² over the window: edges of depth between pixels that look alike, and what later
        stages had to move, make it large.
        """
        kernels, prior, ones, room = self._kernels, self._prior, self._prior.ones, self._room
        seen, matched, spread = self._certainty, self._slope, self._curvature
        kernels.axpby(1.0, self._certainty, -_STILL, ones, room)
        prior.mean(room, seen)

        middle = sum(self._bounds) / 2  # squares of small numbers lose less in their difference
        kernels.axpby(1.0, self._matched, -middle, ones, room)
        prior.mean(room, matched)
        kernels.multiply(room, room, room)
        prior.mean(room, spread)
        kernels.axpby(1.0, self.disparity, -middle, ones, room)
        kernels.axpby(1.0, room, -2.0, matched, matched)
        kernels.multiply(room, matched, matched)
        kernels.axpby(1.0, spread, 1.0, matched, spread)

        kernels.axpby(-0.5, seen, 1 / _DOUBT**2, spread, spread)
        kernels.axpby(1.0, spread, 1.5, ones, spread)
        kernels.divide(ones, spread, self.confidence)
        kernels.clamp(self.confidence, 0.0, 1.0, self.confidence)  # where rounding made s² negative
        if self._known is not None:
            kernels.multiply(self.confidence, self._known, self.confidence)

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


def measured_noise(
    lf: LightField, bounds: tuple[float, float], config: SweepConfig, kernels: KernelSet, device: str
) -> float:
    """How much views differ where they agree, intensity.

    It is the median of the least costs in the middle of the image, of the half of its pixels where they vary most: what
    has no texture agrees at all disparities.
    """
    lf = lf.crop(*(slice(max(0, (side - _SAMPLE) // 2), (side + _SAMPLE) // 2) for side in lf.size))
    lf = lf.subset(used_views(lf, "cross"))
    place = labels(bounds, lf.offsets, config)
    sweep, volume = _planned_sweep(lf, place, config, kernels, device), kernels.zeros((place[2], *lf.size), device)
    views, image = kernels.image(lf.views, device), kernels.zeros_image((*lf.size, lf.channels), device)
    valid = None if lf.valid is None else kernels.field(lf.valid, device)
    kernels.intensities(views, lf.reference_index, valid, scale=lf.scale, fill=UNLIKE_ANY, image_out=image)
    sweep.load(image, views, valid)
    sweep.apertures(volume)
    costs = kernels.numpy(volume)
    least, spread = costs.min(0), np.ptp(costs, axis=0)
    return float(np.median(least[spread >= np.median(spread)]))


def in_units_of(noise: float, config: Config) -> Config:
    """The parameters with all differences of intensity in proportion to the noise; as they are at a noise of 0.004."""
    times = min(max(noise / _USUAL_NOISE, _LEAST_NOISE), _MOST_NOISE)
    return replace(
        config,
        sweep=replace(
            _times(times, config.sweep, "truncation", "gradient_truncation"), noise=min(times * _USUAL_NOISE, 1.0)
        ),
        matching=_times(times, config.matching, "small_step", "large_step", "contrast"),
        alignment=_times(times, config.alignment, "robust"),
        outlines=_times(times, config.outlines, "contrast"),
        prior=_times(times, config.prior, "sigma_color"),
    )


def _times(factor: float, stage: _Stage, *names: str) -> _Stage:
    """Some parameters times a factor, as far as their ranges go."""
    ranges = {f.name: f.metadata for f in fields(stage)}
    changed = {
        name: min(max(factor * getattr(stage, name), ranges[name]["low"]), ranges[name]["high"]) for name in names
    }
    return replace(stage, **changed)


def _planned_sweep(
    lf: LightField, place: tuple[float, float, int], config: SweepConfig, kernels: KernelSet, device: str
) -> PlaneSweep:
    first, step, count = place
    return kernels.plane_sweep(
        (len(lf.views), *lf.size, lf.channels),
        kernels.field(lf.offsets, device),
        kernels.field(apertures(lf.offsets, config.aperture), device),
        first=first,
        step=step,
        count=count,
        scale=lf.scale,
        truncation=config.truncation,
        gradient_weight=config.gradient_weight,
        gradient_truncation=config.gradient_truncation,
        preference=config.preference,
        tolerance=config.tolerance / farthest(lf.offsets),
        least=max(1, math.ceil(config.least_share * (len(lf.views) - 1))),
    )


def used_views(lf: LightField, pattern: str) -> list[int]:
    """Indices of the views of a pattern, in order, or of all if fewer than four beside the reference are in it."""
    used = [int(index) for index in np.flatnonzero(lf.pattern(pattern))]
    return used if len(used) > _FEWEST else list(range(len(lf.views)))


def farthest(offsets: Float64Array) -> float:
    """How far the farthest view is from the reference in u or in v, view steps."""
    return float(np.abs(offsets).max())


def labels(bounds: tuple[float, float], offsets: Float64Array, config: SweepConfig) -> tuple[float, float, int]:
    """First, distance and number of the disparities that are compared: even, from bound to bound.

    They are `config.step` pixels apart in the farthest view, or as far as it takes for `config.most_labels` of them.
    """
    low, high = bounds
    steps = math.ceil((high - low) * farthest(offsets) / config.step)
    count = min(max(steps + 1, 3), config.most_labels)
    return low, (high - low) / (count - 1), count


def apertures(offsets: Float64Array, angle: float) -> Float64Array:
    """Which views belong together, [m, n] of 1 and 0: first all, then those within an angle (degrees) around the
    reference, each with the views on its borders; those that repeat others or are empty left out.
    """
    turns = 2 * np.pi * np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS
    along = np.cos(turns) * offsets[:, 0] + np.sin(turns) * offsets[:, 1]
    ahead = along - math.cos(math.radians(angle) / 2) * np.hypot(*offsets.T) > -_ON_LINE
    others = np.abs(offsets).max(1) > _ON_LINE
    found: dict[bytes, Float64Array] = {}
    for aperture in (np.ones(len(offsets), bool), *ahead):
        used = np.asarray(aperture & others, np.float64)
        if used.any():
            found.setdefault(used.tobytes(), np.asarray(aperture, np.float64))
    return np.stack(list(found.values()))
