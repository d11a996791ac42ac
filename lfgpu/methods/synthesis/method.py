"""Synthesis as a method: its stages, its memory and its halo."""

from __future__ import annotations

import math

import numpy as np

from lfgpu.contract import Device
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.methods.base import Method, Stage
from lfgpu.methods.footprint import GPU_CONTEXT, PROCESS, Footprint
from lfgpu.methods.matching.config import SweepConfig
from lfgpu.methods.matching.noise import measured_noise
from lfgpu.methods.measured import Measured, checked_range
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.model import compared_as
from lfgpu.methods.synthesis.plan import SynthesisPlan
from lfgpu.methods.synthesis.units import spread

_NOISE_SWEEP = SweepConfig(gradient_weight=2.0, view_set_angle=90.0)  # in units of its costs parameters are chosen
_NORMALISED = 16  # views that are normalised at a time on a GPU
_TENSORS = 3  # positions along a line of views over which a structure tensor is summed
_NEIGHBOURHOODS = 6  # half windows after which the influence of a pixel through the solvers is negligible
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

    def measured(self, lf: LightField, bounds: tuple[float, float], device: Device) -> Measured:
        unit = self.config.prior.sigma_unit
        return Measured(
            bounds,
            noise=measured_noise(lf, bounds, _NOISE_SWEEP, device) if unit == "noise" else None,
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
        channels, stored, count = layout.channels, layout.dtype.itemsize, layout.count
        views = count * channels * stored
        masks = 0 if layout.masks is None else 5 * count
        host = 0 if on_gpu else views + masks  # the copy of the tile
        weights = 2 * 4 * ((self.config.prior.window**2 - 1) // 2) + 4 * 3 * channels
        solvers = 4 * 64 if on_gpu else 4 * 40  # the history of L-BFGS and its workspace
        line = len(layout.row()) + len(layout.column())
        if on_gpu:
            size = np.dtype(compared_as(self.config.refinement, on_gpu=True)).itemsize
            details = count * size * (channels + (4 if channels == 3 else 2))  # plain and packed
            batch = min(count, _NORMALISED) * (2 * 4 * channels + 3 * 4)
            lines = line * channels * stored + 4 * _TENSORS * 4 * channels
        else:
            details = 3 * count * 4 * channels
            batch, lines = 0, 2 * line * 4 * channels
        judged = 0
        if self.config.refinement.acceptance == "by-pixel":
            judged = 2 * count * (channels + 1) * stored + 4 * count + 6 * 4
        lines += 4 * 4 + judged
        per_pixel = host + views + details + 8 * count + batch + lines + weights + solvers + masks
        return Footprint(per_pixel, GPU_CONTEXT if on_gpu else PROCESS)

    def halo(self, layout: ViewLayout, measured: Measured) -> tuple[int, int]:
        low, high = measured.disparity_range
        reach = [
            math.ceil(axis * max(abs(low), abs(high))) + math.ceil(axis * (high - low))
            for axis in np.abs(layout.offsets).max(0)
        ]
        windows = (self.config.prior.window // 2) * _NEIGHBOURHOODS + self.config.prior.patch // 2
        return reach[1] + windows + _EDGE, reach[0] + windows + _EDGE

    def plan(self, layout: ViewLayout, measured: Measured, device: Device) -> SynthesisPlan:
        return SynthesisPlan(layout, measured, self.config, device)
