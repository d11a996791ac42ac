"""The noise of the views, and the parameters in its units."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from lfgpu.config import Section
from lfgpu.contract import Device
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import window_max, window_mean, window_min
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.config import MatchingConfig, SweepConfig
from lfgpu.methods.matching.costs import PlaneSweepCost, first_cost
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.tuning import INTENSITY, SLOPE
from lfgpu.methods.matching.views import ChosenViews, used_views
from lfgpu.threads import in_threads

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Stage = TypeVar("_Stage", bound=Section)
_Section = TypeVar("_Section", bound="DataclassInstance")

_SAMPLE = 256  # pixels: side of the part of the image in which the noise is measured
_USUAL_NOISE = 0.004  # intensity: the noise at which parameters are used as they are
_LEAST_NOISE, _LEAST_SMOOTHED, _MOST_NOISE = 0.7, 0.3, 5.0  # range of noise, in units of the usual noise
_CLEAN = 0.0035  # intensity: the noise of views without grain, which are interpolated
_LEFT = 0.3  # share of the grain that is left in the noise of smoothed views
_SEEN = 0.69  # share of the grain in the noise of views, which are interpolated and truncated
_FOURTH_DIFFERENCE = (1, -4, 6, -4, 1)
_GRAIN_WINDOW = 7  # pixels
_GRAIN_SEEN = _GRAIN_WINDOW + len(_FOURTH_DIFFERENCE) - 1  # pixels: side of the part that a window's differences see
_GRAIN_SAMPLE = 512  # pixels: side of the part of the image in which the grain is measured
_BAND = 32  # rows that are differenced together: what lies between two steps stays in the cache
_GRAIN_SHARE = 5  # percent of the windows that show nothing but noise, at least
_LEAST_GRAIN = 5e-5  # intensity: less than a quarter of a step of 12 bits is no noise


def measured_grain(lf: LightField, exposure: float = 1.0) -> float:
    """Measure the grain: the standard deviation of the noise of the reference view, intensity; 0 if there is none.

    `exposure` is that of the views: less than `_LEAST_GRAIN` of it is none.

    Fourth differences in both directions leave less texture beside the noise than the second differences of Immerkær
    (Fast Noise Variance Estimation, 1996). The grain is that of the 5 % of windows with the smallest differences. A
    constant window that holds the brightest or the darkest pixel of the image does not count, as noise may be cut off
    there.
    """
    least = exposure * _LEAST_GRAIN
    lf = lf.crop(*(slice(max(0, (side - _GRAIN_SAMPLE) // 2), (side + _GRAIN_SAMPLE) // 2) for side in lf.size))
    inner = np.s_[2:-2, 2:-2]
    if min(lf.size) < _GRAIN_SEEN:
        return 0.0
    planes = np.ascontiguousarray(np.moveaxis(lf.views[lf.reference_index], -1, 0)) * np.float32(lf.scale)
    bands = [planes[:, top : top + _BAND + 4] for top in range(0, lf.size[0] - 4, _BAND)]
    fine = in_threads(lambda band: np.abs(np.diff(np.diff(band, 4, axis=1), 4, axis=2)).sum(0), bands)
    unit = math.sqrt(math.pi / 2) / np.square(_FOURTH_DIFFERENCE).sum()
    sizes = window_mean(np.concatenate(fine) / np.float32(lf.channels) * np.float32(unit), _GRAIN_WINDOW)
    limits = ((planes == planes.min((1, 2), keepdims=True)) | (planes == planes.max((1, 2), keepdims=True))).any(0)
    counts = (sizes > least) | ~window_max(limits, _GRAIN_SEEN)[inner]
    if lf.valid is not None:
        counts &= window_min(lf.valid[lf.reference_index], _GRAIN_SEEN)[inner]
    grain = float(np.percentile(sizes[counts], _GRAIN_SHARE)) if counts.any() else 0.0
    return grain if grain > least else 0.0


def of_given_noise(noise: float, config: SweepConfig) -> tuple[float, float]:
    """Estimate the noise of smoothed views, and the grain, from a given noise of views as they are; all intensity."""
    grain = math.sqrt(max(0.0, noise**2 - _CLEAN**2)) / _SEEN
    if smoothing_deviation(grain, config) is None:
        return noise, grain
    return min(noise, math.hypot(_CLEAN, _LEFT * noise)), grain


def smoothing_deviation(grain: float | None, config: SweepConfig) -> float | None:
    """Return the difference between pixels of a view that smoothing averages, intensity; None if it does not smooth."""
    return config.smoothing * (grain or 0.0) or None


def measured_noise(
    lf: LightField,
    bounds: tuple[float, float],
    config: MatchingConfig,
    device: Device,
    *,
    deviation: float | None = None,
) -> float:
    """Measure the root mean square difference between views that agree, intensity.

    It is the median of the least costs of a first sweep in the middle of the image, of the half of its pixels where
    they vary most: pixels without texture agree at all disparities. Smoothing, if any, averages differences of
    `deviation`.
    """
    kernels = device.kernels
    lf = lf.crop(*(slice(max(0, (side - _SAMPLE) // 2), (side + _SAMPLE) // 2) for side in lf.size))
    lf = lf.subset(used_views(lf.offsets, "cross"))
    layout = lf.layout
    frame = Frame(
        Arena(device),
        ChosenViews(None, layout, None, layout),
        bounds,
        config,
        deviation=deviation,
    )
    views = frame.swept("all")
    cost, volume = PlaneSweepCost(views, first_cost(config)), device.zeros((frame.disparities.slices, *lf.size))
    frame.load(device.image(lf.views))
    views.load()
    cost.by_view_sets(volume)
    least, negative = (device.zeros(lf.size) for _ in range(2))
    kernels.least_costs(volume, least_out=least)
    kernels.axpby(-1.0, volume, 0.0, volume, volume)
    kernels.least_costs(volume, least_out=negative)
    costs = kernels.numpy(least)
    spread = -kernels.numpy(negative) - costs
    return float(np.median(costs[spread >= np.median(spread)]))


def noise_of_views(noise: float, grain: float | None, config: SweepConfig) -> float:
    """Convert the noise of views as they are compared, which may be smoothed, to that of views as they are stored."""
    return noise if smoothing_deviation(grain, config) is None else math.hypot(noise, _SEEN * (grain or 0.0))


def in_units_of(
    noise: float, config: MatchingConfig, *, grain: float | None = None, exposure: float = 1.0
) -> MatchingConfig:
    """Scale parameters for views of that noise, grain and exposure.

    At a noise of 0.004 of the exposure they stay what `exposed` makes of them, if views are not smoothed.

    Scales of differences between views grow in proportion to the noise of views as they are. Penalties grow with the
    square root of the noise of smoothed views: in proportion to it they are too high in noisy scenes. Truncations stay:
    hidden pixels differ as much with noise as without. The scale of like patches grows with the square root of the
    noise, because noise averages out over a patch.
    """
    least = _LEAST_NOISE if smoothing_deviation(grain, config.sweep) is None else _LEAST_SMOOTHED
    usual, config = exposure * _USUAL_NOISE, exposed(config, exposure)
    swept = min(max(noise / usual, least), _MOST_NOISE)
    times = min(max(noise_of_views(noise, grain, config.sweep) / usual, _LEAST_NOISE), _MOST_NOISE)
    tuning = config.tuning
    alignment, prior = tuning.alignment, tuning.prior
    return replace(
        config,
        sweep=replace(config.sweep, noise=min(swept * usual, 1.0)),
        semi_global=_times(math.sqrt(swept), config.semi_global, "small_penalty", "large_penalty"),
        boundaries=_times(times, config.boundaries, "contrast"),
        tuning=replace(
            tuning,
            alignment=replace(alignment, robust=times * alignment.robust, contrast=times * alignment.contrast),
            prior=replace(prior, sigma_color=math.sqrt(times) * prior.sigma_color),
        ),
    )


def exposed(config: MatchingConfig, exposure: float) -> MatchingConfig:
    """Scale all intensities among the numbers, and penalties, for views that use only that part of the range."""
    if exposure == 1.0:
        return config
    tuning = config.tuning
    sections = {f.name: getattr(tuning, f.name) for f in fields(tuning) if is_dataclass(getattr(tuning, f.name))}
    return replace(
        config,
        semi_global=_times(exposure, config.semi_global, "small_penalty", "large_penalty"),
        boundaries=_times(exposure, config.boundaries, "contrast"),
        tuning=replace(tuning, **{name: _exposed(section, exposure) for name, section in sections.items()}),
    )


def _exposed(section: _Section, exposure: float) -> _Section:
    names = [f.name for f in fields(section) if f.metadata["unit"] in (INTENSITY, SLOPE)]
    return replace(section, **{name: exposure * getattr(section, name) for name in names})


def _times(factor: float, stage: _Stage, *names: str) -> _Stage:
    """Multiply some parameters by a factor, as far as their ranges go."""
    ranges = {f.name: f.metadata for f in fields(stage)}
    changed = {
        name: min(max(factor * getattr(stage, name), ranges[name]["low"]), ranges[name]["high"]) for name in names
    }
    return replace(stage, **changed)
