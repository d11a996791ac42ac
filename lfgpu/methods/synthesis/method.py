"""Synthesis as a method: how much memory it takes and how far a pixel reaches."""

from __future__ import annotations

import math

import numpy as np

from lfgpu.contract import KernelSet
from lfgpu.data.lightfield import LightField
from lfgpu.methods.base import Method, Stage
from lfgpu.methods.footprint import GPU_CONTEXT, PROCESS, Footprint
from lfgpu.methods.measured import Measured
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.plan import SynthesisPlan

_NORMALISED = 16  # views that a GPU normalises at a time
_TENSORS = 3  # places on a line of views that a structure tensor is summed over
_NEIGHBOURHOODS = 6  # windows beyond which the solvers carry hardly anything
_EDGE = 34  # pixels at the edge of a tile in which the solvers miss what lies beyond it


class Synthesis(Method[SynthesisConfig]):
    """The map from which the reference view predicts all others best (`lfgpu/methods/synthesis/plan.py`)."""

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

    def footprint(self, lf: LightField, measured: Measured, *, on_gpu: bool) -> Footprint:
        channels, stored, count = lf.channels, lf.views.dtype.itemsize, len(lf.views)
        views = count * channels * stored
        masks = 0 if lf.valid is None else 5 * count
        host = 0 if on_gpu else views + masks  # the tile as it was cut out
        weights = 2 * 4 * ((self.config.prior.window**2 - 1) // 2) + 4 * 3 * channels
        solvers = 4 * 64 if on_gpu else 4 * 40  # pairs of steps that L-BFGS remembers, and what else it keeps
        line = len(lf.row()) + len(lf.column())
        if on_gpu:
            details = count * 2 * (channels + (4 if channels == 3 else 2))  # as they are and packed, in half precision
            batch = min(count, _NORMALISED) * (2 * 4 * channels + 3 * 4)
            lines = line * channels * stored + 4 * _TENSORS * 4 * channels
        else:
            details = 3 * count * 4 * channels
            batch, lines = 0, 2 * line * 4 * channels
        per_pixel = host + views + details + 8 * count + batch + lines + weights + solvers + masks
        return Footprint(per_pixel, GPU_CONTEXT if on_gpu else PROCESS)

    def halo(self, lf: LightField, measured: Measured) -> tuple[int, int]:
        low, high = measured.disparity_range
        reach = [
            math.ceil(axis * max(abs(low), abs(high))) + math.ceil(axis * (high - low))
            for axis in np.abs(lf.offsets).max(0)
        ]
        windows = (self.config.prior.window // 2) * _NEIGHBOURHOODS + self.config.prior.patch // 2
        return reach[1] + windows + _EDGE, reach[0] + windows + _EDGE

    def plan(self, lf: LightField, measured: Measured, kernels: KernelSet, device: str) -> SynthesisPlan:
        return SynthesisPlan(lf, measured.disparity_range, self.config, kernels, device)
