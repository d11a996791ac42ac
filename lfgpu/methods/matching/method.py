"""Matching as a method: what it measures, how much memory it takes and how far a pixel reaches."""

from __future__ import annotations

import math

from lfgpu.contract import FACET_REACH, REACH, REDUCTION, SMOOTHING_REACH, Device, Float64Array, Streaming
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.methods.base import Method, Stage
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.disparities import (
    NETWORK_MOST,
    NETWORK_STEP,
    are_in_windows,
    compared_disparities,
    compared_reach,
    network_reach,
    padded_disparities,
)
from lfgpu.methods.matching.guesses import GUESS_REACH
from lfgpu.methods.matching.learned import NETWORK_REACH
from lfgpu.methods.matching.noise import exposed, measured_grain, measured_noise, of_given_noise, smoothing_deviation
from lfgpu.methods.matching.passes import sweeps_of
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.matching.temporal import TemporalMatching
from lfgpu.methods.matching.views import used_views
from lfgpu.methods.measured import Measured, Shown, checked_range, exposure_of
from lfgpu.methods.temporal_prior import TemporalPrior

_REDUCED = 3  # pixels of reduced views on which a pixel depends: by differences and by interpolation
_PATHS = 60  # pixels at the edge of a tile from which semi-global matching learns where its paths come from


class Matching(Method[MatchingConfig]):
    """The surface on which the views agree that see it (`lfgpu/methods/matching/plan.py`)."""

    STAGES = (
        Stage("sweep", "sweep"),
        Stage("resweep", "further sweeps"),
        Stage("align", "alignment", "step", "px per view step, rms"),
        Stage("boundaries", "boundaries and holes"),
    )
    TRACED = "align"
    MATCHED = "sweep"
    is_recordable = True

    @property
    def stages(self) -> tuple[Stage, ...]:
        again = self.config.sweep.resweeps > 0
        return tuple(stage for stage in self.STAGES if again or stage.name != "resweep")

    @property
    def for_rendering(self) -> MatchingConfig:
        # A pixel that mixes both sides of a depth edge looks best with the nearer side.
        return self.config.with_values({"boundaries.contrast": 10.0})

    def iterations(self, stage: str) -> int | None:
        return self.config.alignment.iterations if stage == "align" else None

    def used_views(self, offsets: Float64Array) -> list[int]:
        return used_views(offsets, self.config.sweep.views)

    def measured(
        self, lf: LightField, bounds: tuple[float, float], device: Device, *, shown: Shown | None = None
    ) -> Measured:
        config = self.config.sweep
        if config.noise:
            return Measured(bounds, *of_given_noise(config.noise, config))
        exposure = exposure_of(lf)
        grain = measured_grain(lf, device, exposure, shown=shown)
        deviation = smoothing_deviation(grain, config)
        noise = measured_noise(lf, bounds, exposed(self.config, exposure), device, deviation=deviation, shown=shown)
        return Measured(bounds, noise, grain, exposure=exposure)

    def given(
        self, layout: ViewLayout, disparity_range: tuple[float, float] | None, noise: float | None = None
    ) -> Measured | None:
        known = self.config.sweep.noise or noise
        if disparity_range is None or known is None:
            return None
        return Measured(checked_range(disparity_range, layout), *of_given_noise(known, self.config.sweep))

    def same_surface(self, layout: ViewLayout) -> float:
        return self.config.tuning.alignment.support / layout.farthest

    def doubt(self, layout: ViewLayout, bounds: tuple[float, float]) -> str | None:
        config, offsets = self.config.sweep, layout.offsets[self.used_views(layout.offsets)]
        # A preset with two maps is limited if both are; then the sentence on its sweeps has more to advise.
        for is_network in sorted({sweep.aggregation == "learned" for sweep in sweeps_of(self.config)}, reverse=True):
            if is_network:
                limit, reach, most = NETWORK_STEP, network_reach(offsets, bounds), NETWORK_MOST
                compared, by, remedy = padded_disparities(bounds, reach), "network", ""
            else:
                limit, reach, most = config.step, compared_reach(offsets, bounds, config), config.max_labels
                compared, by = compared_disparities(bounds, reach, config), "sweeps"
                remedy = ", or a larger sweep.max_labels"
            if math.isclose(reach * compared.step, limit):
                return None
        return (
            f"The disparity range from {bounds[0]:.3g} to {bounds[1]:.3g} px per view step is so wide that the "
            f"{most} disparities that are compared lie {reach * compared.step:.2g} px apart in the farthest view of "
            f"the {by}, not {limit:g}: surfaces may be missed; give a narrower range{remedy}."
        )

    def halo(self, layout: ViewLayout, measured: Measured) -> tuple[int, int]:
        down, across = self.shifts(layout, measured)
        passes = 2 + 2 * self.config.sweep.resweeps + 2 * self.config.alignment.iterations
        windows = (self.config.prior.window // 2) * passes + self.config.tuning.prior.patch // 2 + 2 * (REACH + 1)
        windows += SMOOTHING_REACH + 1 + _REDUCED * REDUCTION
        windows += GUESS_REACH * self.config.sweep.resweeps
        seen = _PATHS
        if sweeps_of(self.config)[-1].aggregation == "learned":
            offsets = layout.offsets[self.used_views(layout.offsets)]
            is_twice = are_in_windows(offsets, measured.disparity_range)
            seen = 2 * (NETWORK_REACH + FACET_REACH) if is_twice else NETWORK_REACH
        return down + windows + seen, across + windows + seen

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
