"""The noise of the views, and the parameters in its units."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from lfgpu.config import Section
from lfgpu.contract import GRAIN_WINDOW, Device
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.methods.arena import Arena
from lfgpu.methods.matching.config import MatchingConfig, SweepConfig
from lfgpu.methods.matching.costs import PlaneSweepCost, first_cost
from lfgpu.methods.matching.frame import Frame
from lfgpu.methods.matching.tuning import INTENSITY, SLOPE
from lfgpu.methods.matching.views import ChosenViews, used_views
from lfgpu.methods.measured import Shown, Typical, load_window

_Stage = TypeVar("_Stage", bound=Section)

_SAMPLE = 256  # pixels: side of the part of the image in which the noise is measured
_USUAL_NOISE = 0.004  # intensity: the noise at which parameters are used as they are
_LEAST_NOISE, _LEAST_SMOOTHED, _MOST_NOISE = 0.7, 0.3, 5.0  # range of noise, in units of the usual noise
_CLEAN = 0.0035  # intensity: the noise of views without grain, which are interpolated
_LEFT = 0.3  # share of the grain that is left in the noise of smoothed views
_SEEN = 0.69  # share of the grain in the noise of views, which are interpolated and truncated
_GRAIN_SAMPLE = 512  # pixels: side of the part of the image in which the grain is measured
_GRAIN_SHARE = 0.05  # of the windows that show nothing but noise, at least
_LEAST_GRAIN = 5e-5  # intensity: less than a quarter of a step of 12 bits is no noise


def _middle(lf: LightField, most: int) -> tuple[slice, slice]:
    """Return the rows and columns of the middle of an image, so many at most."""
    height, width = (slice(max(0, (side - most) // 2), min(side, (side + most) // 2)) for side in lf.size)
    return height, width


def measured_grain(lf: LightField, device: Device, exposure: float = 1.0, *, shown: Shown | None = None) -> float:
    """Measure the grain: the standard deviation of the noise of the reference view, intensity; 0 if there is none.

    `exposure` is that of the views: less than `_LEAST_GRAIN` of it is none.

    Fourth differences in both directions leave less texture beside the noise than the second differences of Immerkær
    (Fast Noise Variance Estimation, 1996). The grain is that of the 5 % of windows with the smallest differences. A
    constant window that holds the brightest or the darkest pixel of the image does not count, as noise may be cut off
    there.
    """
    least, window = exposure * _LEAST_GRAIN, _middle(lf, _GRAIN_SAMPLE)
    layout = lf.layout.crop(*window)
    if min(layout.size) < GRAIN_WINDOW + 4:
        return 0.0
    grain_of = device.kept("grain", layout.shape, lambda: _Grain(device, layout))
    grain = grain_of(lf, window, least, shown)
    return grain if grain > least else 0.0


class _Grain:
    """The quantile of differences in windows of the reference view, with its memory."""

    def __init__(self, device: Device, layout: ViewLayout) -> None:
        height, width, channels = shape = layout.shape[1:]
        self._device, self._found, self._scale = device, device.scalar(0.0), layout.scale
        self._view, self._image = device.zeros_image((1, *shape), layout.dtype.type), device.zeros_image(shape)
        self._limits = device.zeros((2, channels))
        self._differences, self._limited, self._grain = (device.zeros((height - 4, width - 4)) for _ in range(3))

    def __call__(self, lf: LightField, window: tuple[slice, slice], least: float, shown: Shown | None) -> float:
        kernels, reference = self._device.kernels, lf.reference_index
        load_window(lf, [reference], *window, self._device, shown, views_out=self._view)
        valid = None if lf.valid is None else self._device.field(lf.valid[reference][window][None])
        kernels.intensities(self._view, 0, valid, scale=self._scale, fill=math.nan, image_out=self._image)
        view = lf.views[reference][window]
        rows = view.reshape(len(view), -1)  # whole rows, as few channels are slow to compare
        limits = [end(end(rows, 0).reshape(view.shape[1:]), 0) for end in (np.min, np.max)]
        kernels.upload(np.stack(limits) * np.float32(self._scale), self._limits)
        kernels.window_grain(
            self._image,
            self._limits,
            least=least,
            differences_out=self._differences,
            limited_out=self._limited,
            grain_out=self._grain,
        )
        kernels.quantile(self._grain, _GRAIN_SHARE, quantile_out=self._found)
        return kernels.number(self._found)


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
    shown: Shown | None = None,
) -> float:
    """Measure the root mean square difference between views that agree, intensity.

    It is the median of the least costs of a first sweep in the middle of the image, of the half of its pixels where
    they vary most: pixels without texture agree at all disparities. Smoothing, if any, averages differences of
    `deviation`.
    """
    chosen, window = used_views(lf.offsets, "cross"), _middle(lf, _SAMPLE)
    layout = lf.layout.subset(chosen).crop(*window)
    numbers = None if device.is_gpu and device.kernels.changing else (bounds, deviation)  # which cannot change then
    sweep = device.kept(
        "noise",
        (config, layout.shape, numbers),
        lambda: _FirstSweep(device, layout, bounds, config, deviation),
        lambda sweep: sweep.follow(bounds, config, deviation),
    )
    load_window(lf, chosen, *window, device, shown, views_out=sweep.views)
    return sweep()


class _FirstSweep:
    """A sweep whose least costs are the noise, with its memory."""

    def __init__(
        self,
        device: Device,
        layout: ViewLayout,
        bounds: tuple[float, float],
        config: MatchingConfig,
        deviation: float | None,
    ) -> None:
        arena, chosen = Arena(device, follows=device.is_gpu), ChosenViews(None, layout, None, layout, layout.farthest)
        self._frame = Frame(arena, chosen, bounds, config, deviation=deviation)
        self._frame.goes_with(self)
        self._kernels = device.kernels
        with self._frame.planning():
            self._cost = PlaneSweepCost(self._frame.swept("all"), first_cost(config))
        self.views = device.zeros_image(layout.shape, layout.dtype.type)
        """The views [n, y, x, c] that it compares; whoever calls it writes them."""
        self._volume = device.zeros((self._frame.disparities.slices, *layout.size))
        self._least, self._spread = (device.zeros(layout.size) for _ in range(2))
        self._typical = Typical(device)
        arena.follow()

    def follow(self, bounds: tuple[float, float], config: MatchingConfig, deviation: float | None) -> bool:
        """Go on with other numbers; tell whether that is possible."""
        return self._frame.follow(bounds, config, deviation=deviation)

    def __call__(self) -> float:
        kernels, volume, least, spread = self._kernels, self._volume, self._least, self._spread
        self._frame.load(self.views)
        self._cost.by_view_sets(volume)
        compared = self._frame.disparities
        if compared.count < compared.slices:
            volume = volume[: compared.count]
        kernels.least_costs(volume, least_out=least)
        kernels.axpby(-1.0, volume, 0.0, volume, volume)
        kernels.least_costs(volume, least_out=spread)
        kernels.axpby(-1.0, spread, -1.0, least, spread)
        return kernels.number(self._typical(least, spread))


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
    tuning, sections = config.tuning, {}
    for part in fields(tuning):
        if is_dataclass(getattr(tuning, part.name)):
            section: Any = getattr(tuning, part.name)
            names = [f.name for f in fields(section) if f.metadata["unit"] in (INTENSITY, SLOPE)]
            sections[part.name] = replace(section, **{name: exposure * getattr(section, name) for name in names})
    return replace(
        config,
        semi_global=_times(exposure, config.semi_global, "small_penalty", "large_penalty"),
        boundaries=_times(exposure, config.boundaries, "contrast"),
        tuning=replace(tuning, **sections),
    )


def _times(factor: float, stage: _Stage, *names: str) -> _Stage:
    """Multiply some parameters by a factor, as far as their ranges go."""
    return stage.within(**{name: factor * getattr(stage, name) for name in names})
