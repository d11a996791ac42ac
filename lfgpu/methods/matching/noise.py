"""The noise of the views, and the parameters in its units."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from lfgpu.config import Section
from lfgpu.contract import WHITE, Device
from lfgpu.data.channels import mean_of_channels
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import window_max, window_mean, window_min
from lfgpu.methods.matching.config import MatchingConfig, SweepConfig
from lfgpu.methods.matching.sweep import labels, planned_sweep, sweep_cost, used_views
from lfgpu.methods.prior import UNLIKE_ANY

_Stage = TypeVar("_Stage", bound=Section)

_SAMPLE = 256  # pixels, side of what the noise is measured in
_USUAL_NOISE = 0.004  # intensity: what the defaults are meant for
_LEAST_NOISE, _LEAST_SMOOTHED, _MOST_NOISE = 0.7, 0.3, 5.0  # in units of that: of views as they are, and smoothed
_CLEAN = 0.0035  # intensity: what views without grain differ by, as they are interpolated
_LEFT = 0.3  # of the grain in their difference when they are smoothed
_SEEN = 0.69  # of the grain of views that is seen in their difference, which is interpolated and truncated
_FOURTH_DIFFERENCE = (1, -4, 6, -4, 1)
_GRAIN_WINDOW = 7  # pixels
_GRAIN_SEEN = _GRAIN_WINDOW + len(_FOURTH_DIFFERENCE) - 1  # pixels, side of what has a part in a window's differences
_GRAIN_SAMPLE = 512  # pixels, side of what the grain is measured in
_GRAIN_SHARE = 5  # percent of the windows that show nothing but noise, at least
_LEAST_GRAIN = 1e-4  # intensity: less than a step of 12 bits is no noise


def measured_grain(lf: LightField) -> float:
    """The standard deviation of the noise of the reference view, intensity; 0 if there is none.

    Fourth differences in both directions leave little but noise: of texture, less than the second differences that
    Immerkær takes (Fast Noise Variance Estimation, 1996). The 5 % of windows with the least of that are taken. Windows
    that hold the brightest or the darkest of the image may be cut off there: if such a window is constant it does not
    count.
    """
    lf = lf.crop(*(slice(max(0, (side - _GRAIN_SAMPLE) // 2), (side + _GRAIN_SAMPLE) // 2) for side in lf.size))
    inner = np.s_[2:-2, 2:-2]
    if min(lf.size) < _GRAIN_SEEN:
        return 0.0
    image = lf.views[lf.reference_index].astype(np.float32) * np.float32(lf.scale)
    fine = np.diff(np.diff(image, 4, axis=0), 4, axis=1)
    sizes = mean_of_channels(np.abs(fine), np.float32) * np.float32(
        math.sqrt(math.pi / 2) / np.square(_FOURTH_DIFFERENCE).sum()
    )
    sizes = window_mean(sizes, _GRAIN_WINDOW)
    limits = np.zeros(lf.size, np.bool_)
    for c in range(lf.channels):
        channel = image[..., c]
        limits |= (channel == channel.min()) | (channel == channel.max())
    counts = (sizes > _LEAST_GRAIN) | ~window_max(limits, _GRAIN_SEEN)[inner]
    if lf.valid is not None:
        counts &= window_min(lf.valid[lf.reference_index], _GRAIN_SEEN)[inner]
    return max(0.0, float(np.percentile(sizes[counts], _GRAIN_SHARE))) if counts.any() else 0.0


def of_given_noise(noise: float, config: SweepConfig) -> tuple[float, float]:
    """The noise of smoothed views, and the grain, if views as they are differ by `noise` and nothing is measured."""
    grain = math.sqrt(max(0.0, noise**2 - _CLEAN**2)) / _SEEN
    if smoothing_deviation(grain, config) is None:
        return noise, grain
    return min(noise, math.hypot(_CLEAN, _LEFT * noise)), grain


def smoothing_deviation(grain: float | None, config: SweepConfig) -> float | None:
    """What pixels of a view that are alike differ by, intensity; None if views are not smoothed."""
    deviation = config.smoothing * (grain or 0.0)
    return deviation if deviation > _LEAST_GRAIN else None


def measured_noise(
    lf: LightField,
    bounds: tuple[float, float],
    config: SweepConfig,
    device: Device,
    *,
    deviation: float | None = None,
) -> float:
    """How much views differ where they agree, intensity. With a `deviation` they are smoothed by it first.

    It is the median of the least costs in the middle of the image, of the half of its pixels where they vary most: what
    has no texture agrees at all disparities.
    """
    kernels = device.kernels
    lf = lf.crop(*(slice(max(0, (side - _SAMPLE) // 2), (side + _SAMPLE) // 2) for side in lf.size))
    lf = lf.subset(used_views(lf.layout, "cross"))
    place = labels(bounds, lf.offsets, config)
    shape, scale = (len(lf.views), *lf.size, lf.channels), lf.scale if deviation is None else 1 / WHITE
    sweep = planned_sweep(shape, lf.offsets, place, config, device, scale=scale)
    volume = device.zeros((place[2], *lf.size))
    views, image = device.image(lf.views), device.zeros_image((*lf.size, lf.channels))
    valid = None if lf.valid is None else device.field(lf.valid)
    if deviation is not None:
        recorded, views = views, device.zeros_image(shape, np.uint16)
        kernels.smooth_views(recorded, valid, scale=lf.scale, deviation=deviation, views_out=views)
    kernels.intensities(views, lf.reference_index, valid, scale=scale, fill=UNLIKE_ANY, image_out=image)
    sweep.load(image, views, valid)
    sweep.by_view_sets(sweep_cost(config, config.gradient_weight), volume)
    least, negative = (device.zeros(lf.size) for _ in range(2))
    kernels.least_costs(volume, least_out=least)
    kernels.axpby(-1.0, volume, 0.0, volume, volume)
    kernels.least_costs(volume, least_out=negative)
    costs, spread = kernels.numpy(least), -kernels.numpy(negative) - kernels.numpy(least)
    return float(np.median(costs[spread >= np.median(spread)]))


def noise_of_views(noise: float, grain: float | None, config: SweepConfig) -> float:
    """How much views differ as they are, intensity, if they differ by `noise` once they are smoothed."""
    return noise if smoothing_deviation(grain, config) is None else math.hypot(noise, _SEEN * (grain or 0.0))


def in_units_of(noise: float, config: MatchingConfig, *, grain: float | None = None) -> MatchingConfig:
    """The parameters for views with that noise and grain; as they are at a noise of 0.004 without smoothing.

    The scales of what views differ by grow in proportion to the noise of views as they are. Penalties grow with the
    square root of the noise of smoothed views: in proportion to it they are too high in noisy scenes. Truncations stay:
    what is hidden differs as much with noise as without. Which pixels are alike is decided by means over patches, where
    noise averages out: that scale grows with the square root, too.
    """
    least = _LEAST_NOISE if smoothing_deviation(grain, config.sweep) is None else _LEAST_SMOOTHED
    swept = min(max(noise / _USUAL_NOISE, least), _MOST_NOISE)
    times = min(max(noise_of_views(noise, grain, config.sweep) / _USUAL_NOISE, _LEAST_NOISE), _MOST_NOISE)
    return replace(
        config,
        sweep=replace(config.sweep, noise=min(swept * _USUAL_NOISE, 1.0)),
        semi_global=_times(math.sqrt(swept), config.semi_global, "small_penalty", "large_penalty"),
        alignment=_times(times, config.alignment, "robust", "contrast"),
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
