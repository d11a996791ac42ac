"""The noise of the views, and the parameters in its units."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from lfgpu.config import Section
from lfgpu.contract import KernelSet
from lfgpu.data.lightfield import LightField
from lfgpu.methods.matching.config import MatchingConfig, SweepConfig
from lfgpu.methods.matching.sweep import labels, planned_sweep, used_views
from lfgpu.methods.prior import UNLIKE_ANY

_Stage = TypeVar("_Stage", bound=Section)

_SAMPLE = 256  # pixels, side of what the noise is measured in
_USUAL_NOISE = 0.004  # intensity: what the defaults are meant for
_LEAST_NOISE, _MOST_NOISE = 0.7, 5.0  # in units of that


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
    sweep, volume = planned_sweep(lf, place, config, kernels, device), kernels.zeros((place[2], *lf.size), device)
    views, image = kernels.image(lf.views, device), kernels.zeros_image((*lf.size, lf.channels), device)
    valid = None if lf.valid is None else kernels.field(lf.valid, device)
    kernels.intensities(views, lf.reference_index, valid, scale=lf.scale, fill=UNLIKE_ANY, image_out=image)
    sweep.load(image, views, valid)
    sweep.by_view_sets(volume)
    least, negative = (kernels.zeros(lf.size, device) for _ in range(2))
    kernels.least_costs(volume, least_out=least)
    kernels.axpby(-1.0, volume, 0.0, volume, volume)
    kernels.least_costs(volume, least_out=negative)
    costs, spread = kernels.numpy(least), -kernels.numpy(negative) - kernels.numpy(least)
    return float(np.median(costs[spread >= np.median(spread)]))


def in_units_of(noise: float, config: MatchingConfig) -> MatchingConfig:
    """The parameters for views with that noise; as they are at a noise of 0.004.

    Penalties and the scales of what views differ by grow in proportion to the noise. Truncations stay: what is hidden
    differs as much with noise as without. Which pixels are alike is decided by means over patches, where noise averages
    out: that scale grows with the square root.
    """
    times = min(max(noise / _USUAL_NOISE, _LEAST_NOISE), _MOST_NOISE)
    return replace(
        config,
        sweep=replace(config.sweep, noise=min(times * _USUAL_NOISE, 1.0)),
        semi_global=_times(times, config.semi_global, "small_penalty", "large_penalty", "contrast"),
        alignment=_times(times, config.alignment, "robust"),
        boundaries=_times(times, config.boundaries, "contrast"),
        prior=_times(math.sqrt(times), config.prior, "sigma_color"),
    )


def _times(factor: float, stage: _Stage, *names: str) -> _Stage:
    """Some parameters times a factor, as far as their ranges go."""
    ranges = {f.name: f.metadata for f in fields(stage)}
    changed = {
        name: min(max(factor * getattr(stage, name), ranges[name]["low"]), ranges[name]["high"]) for name in names
    }
    return replace(stage, **changed)
