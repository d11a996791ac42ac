"""Matching as a method: what it measures, how much memory it takes and how far a pixel reaches."""

from __future__ import annotations

import math

import numpy as np

from lfgpu.contract import REACH, REDUCTION, SMOOTHING_REACH, Device, Streaming
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.methods.base import Method, Stage
from lfgpu.methods.footprint import GPU_CONTEXT, PROCESS, Footprint
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.guesses import GUESS_REACH
from lfgpu.methods.matching.noise import measured_grain, measured_noise, of_given_noise, smoothing_deviation
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.matching.sweep import first_views, labels, middle_views, swept_views, used_views
from lfgpu.methods.matching.temporal import TemporalMatching
from lfgpu.methods.measured import Measured, checked_range
from lfgpu.methods.temporal_prior import TemporalPrior

_SLICES = 16  # that work on a CPU is cut into, some of which have a workspace of their own
_STEP_COSTS = 8 * 2 * 4  # bytes: of the steps to a pixel in all directions, which a GPU keeps
_SPARE_VOLUMES, _DIRECTIONS = 7, 2**29  # of directions beside the first one, and their bytes, at most
_REDUCED = 3  # pixels of reduced views: differences, and what is interpolated between them
_PATHS = 60  # pixels at the edge of a tile from which semi-global matching learns where its paths come from


class Matching(Method[MatchingConfig]):
    """The surface on which the views agree, each as far as nothing hides it (`lfgpu/methods/matching/plan.py`)."""

    STAGES = (
        Stage("sweep", "plane sweep"),
        Stage("resweep", "further plane sweeps"),
        Stage("align", "alignment", "step", "px per view step, rms"),
        Stage("boundaries", "boundary refinement and hole filling"),
    )
    TRACED = "align"
    MATCHED = "sweep"

    @property
    def stages(self) -> tuple[Stage, ...]:
        again = self.config.sweep.resweeps > 0
        return tuple(stage for stage in self.STAGES if again or stage.name != "resweep")

    @property
    def is_recordable(self) -> bool:
        return True

    @property
    def for_rendering(self) -> MatchingConfig:
        # A pixel that mixes both sides of a depth edge looks best with the nearer side.
        return self.config.with_values({"boundaries.contrast": 10.0})

    def iterations(self, stage: str) -> int | None:
        return self.config.alignment.iterations if stage == "align" else None

    def used_views(self, layout: ViewLayout) -> list[int]:
        return used_views(layout, self.config.sweep.views)

    def measured(self, lf: LightField, bounds: tuple[float, float], device: Device) -> Measured:
        config = self.config.sweep
        if config.noise:
            return Measured(bounds, *of_given_noise(config.noise, config))
        grain = measured_grain(lf)
        deviation = smoothing_deviation(grain, config)
        return Measured(bounds, measured_noise(lf, bounds, config, device, deviation=deviation), grain)

    def given(
        self, layout: ViewLayout, disparity_range: tuple[float, float] | None, noise: float | None = None
    ) -> Measured | None:
        known = self.config.sweep.noise or noise
        if disparity_range is None or known is None:
            return None
        return Measured(checked_range(disparity_range, layout), *of_given_noise(known, self.config.sweep))

    def same_surface(self, layout: ViewLayout) -> float:
        return self.config.alignment.support / layout.farthest

    def footprint(self, layout: ViewLayout, measured: Measured, *, on_gpu: bool) -> Footprint:
        config, channels, stored = self.config, layout.channels, layout.dtype.itemsize
        used = self.used_views(layout)
        chosen = swept_views(layout.offsets[used], config.sweep.views)
        some, in_first = len(chosen), set(first_views(layout, config.sweep.first_views))
        taken, copied = len(used), some if some < len(used) else 0
        views = (taken + copied) * channels * stored
        masks = 0 if layout.masks is None else 5 * taken + 4 * copied
        host = 0 if on_gpu else taken * channels * stored + masks  # the tile as it was cut out
        smoothed, compared = 0, stored
        if smoothing_deviation(measured.grain, config.sweep) is not None:
            smoothed, compared = 2 * some * channels, 2
        packed = (taken + copied) * (4 if channels == 3 else 2) * stored  # a pixel with whether it is valid
        few = sum(used[view] in in_first for view in chosen)
        copied_few = few * channels * compared if few < some else 0
        between = 0
        if config.sweep.resweeps > 1:
            middle = len(middle_views(layout.offsets[used][chosen], config.sweep.views))
            between = middle if middle < some else 0
        copied_few += between * channels * compared
        compared *= (some if config.sweep.resweeps else 0) + between + few
        swept = (channels if not on_gpu else 4 if channels == 3 else 2) * compared + smoothed + copied_few
        if config.sweep.reduced_weight:
            swept += -(-(2 * 2 * few * channels + masks) // REDUCTION**2)
        volume = 4 * labels(measured.disparity_range, layout.offsets, config.sweep)[2]
        volumes = (4 if on_gpu else 2) * volume
        if config.sweep.reduced_weight:
            volumes += -(-(volume + 4) // REDUCTION**2)  # and a weight for each pixel
        weights = 2 * 4 * ((config.prior.window**2 - 1) // 2) + 4 * 3 * channels
        if config.semi_global.window != config.prior.window:
            weights += 4 * ((config.semi_global.window**2 - 1) // 2) + 4 * 3 * channels
        hiding = 4 * (taken + copied + between)
        if on_gpu and config.sweep.resweeps:
            hiding += 2 * (some + between)  # the first disparity past the surface
        buffers = 1 + int(copied > 0) + min(config.sweep.resweeps, 2 + int(between > 0))
        workspaces = _STEP_COSTS if on_gpu else buffers * 4 * _SLICES
        weighed = 1 + int(copied > 0)  # how much gradients count, in each alignment
        guessed = 2 * int(config.sweep.resweeps > 0)  # zeros, and the evidence of the first sweep
        fields = 4 * (26 + weighed + guessed + 2 * channels)
        per_pixel = host + views + swept + packed + hiding + volumes + weights + workspaces + fields + masks
        if not on_gpu:
            return Footprint(per_pixel, PROCESS)
        return Footprint(per_pixel, GPU_CONTEXT, _SPARE_VOLUMES * volume, _DIRECTIONS)

    def halo(self, layout: ViewLayout, measured: Measured) -> tuple[int, int]:
        low, high = measured.disparity_range
        # The largest shift in any view, and the largest difference of shifts: what may hide a pixel there.
        reach = [
            math.ceil(axis * max(abs(low), abs(high))) + math.ceil(axis * (high - low))
            for axis in np.abs(layout.offsets).max(0)
        ]
        passes = 2 + 2 * self.config.sweep.resweeps + 2 * self.config.alignment.iterations
        windows = (self.config.prior.window // 2) * passes + self.config.prior.patch // 2 + 2 * (REACH + 1)
        windows += SMOOTHING_REACH + 1 + _REDUCED * REDUCTION
        windows += GUESS_REACH * self.config.sweep.resweeps
        return reach[1] + windows + _PATHS, reach[0] + windows + _PATHS

    def plan(self, layout: ViewLayout, measured: Measured, device: Device) -> MatchingPlan:
        return MatchingPlan(layout, measured, self.config, device)

    def live_plan(
        self,
        layout: ViewLayout,
        measured: Measured,
        device: Device,
        *,
        streaming: Streaming,
        prior: TemporalPrior,
    ) -> TemporalMatching:
        return TemporalMatching(layout, measured, self.config, device, streaming=streaming, prior=prior)
