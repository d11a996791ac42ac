"""Synthesis as a method: its stages, its memory and its halo."""

from dataclasses import replace

from lfgpu.contract import Device
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.methods.base import Method, Stage
from lfgpu.methods.footprint import Footprint
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.noise import measured_noise
from lfgpu.methods.measured import Measured, Shown, checked_range
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.plan import SynthesisPlan, spread

_NOISE_SWEEP = MatchingConfig().with_tuning(  # in units of its costs parameters are chosen
    {"sweep.gradient_weight": 2.0, "sweep.view_set_angle": 90.0}
)
_NEIGHBOURHOODS = 6  # half windows after which the influence of a pixel through the solvers is negligible
_HOST_SOLVER = 4 * 40  # bytes per pixel that L-BFGS-B of SciPy takes
_EDGE = 34  # pixels at the edge of a tile where the missing neighbours change the result


class Synthesis(Method[SynthesisConfig]):
    """The disparity map with which the reference view predicts all other views best (Sajjadi et al. 2016)."""

    STAGES = (
        Stage("local", "local estimate"),
        Stage("propagate", "propagation", "residual"),
        Stage("refine", "refinement", "energy", has_start=True),
    )
    TRACED = "refine"

    def iterations(self, stage: str) -> int | None:
        limits = {
            "propagate": self.config.propagation.max_iterations,
            "refine": self.config.refinement.max_iterations,
        }
        return limits.get(stage)

    @property
    def is_on_device(self) -> bool:
        return self.config.propagation.solver == "cg" and self.config.refinement.solver == "lbfgs"

    def measured(
        self, lf: LightField, bounds: tuple[float, float], device: Device, *, shown: Shown | None = None
    ) -> Measured:
        unit = self.config.prior.sigma_unit
        return Measured(
            bounds,
            noise=measured_noise(lf, bounds, _NOISE_SWEEP, device, shown=shown) if unit == "noise" else None,
            spread=spread(lf, self.config.prior.patch) if unit == "image" else None,
        )

    def given(
        self, layout: ViewLayout, disparity_range: tuple[float, float] | None, noise: float | None = None
    ) -> Measured | None:
        unit = self.config.prior.sigma_unit
        if disparity_range is None or unit == "image" or (unit == "noise" and noise is None):
            return None
        return Measured(checked_range(disparity_range, layout), noise)

    def footprint(self, layout: ViewLayout, measured: Measured, *, on_gpu: bool) -> Footprint:
        found = super().footprint(layout, measured, on_gpu=on_gpu)
        if on_gpu or self.is_on_device:
            return found
        return replace(found, per_pixel=found.per_pixel + _HOST_SOLVER)

    def halo(self, layout: ViewLayout, measured: Measured) -> tuple[int, int]:
        down, across = self.shifts(layout, measured)
        windows = (self.config.prior.window // 2) * _NEIGHBOURHOODS + self.config.prior.patch // 2
        return down + windows + _EDGE, across + windows + _EDGE

    def plan(self, layout: ViewLayout, measured: Measured, device: Device) -> SynthesisPlan:
        return SynthesisPlan(layout, measured, self.config, device)
