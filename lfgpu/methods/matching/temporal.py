"""What one frame of a stream leaves for the next: where surfaces were, how they moved, and what they looked like.

First the motion of the reference view is found, and what is known of each surface moves along: its disparity, which is
then past + rate, the rate at which that changes, and the number of frames that it rests on. Three things come from it.
The views that should see these surfaces are those that are compared, which spares the first sweep; where the reference
view has changed, nothing is hidden by what was there. Costs get
strength * same * confidence * min(|d - past|, reach) / reach on top, so that what looks alike at several disparities
does not jump between them. And the new map is averaged with the expected one, pixel by pixel, as by a Kalman filter
whose measurements are all as good as each other: with the number of frames that went into a pixel so far,

    before = persistence * same * frames / (1 + ((past - d) / support)^4) / (1 + (rate / steady)^2),
    d <- (d + before past) / (1 + before),   frames <- 1 + before.

`same` is 1 where the reference view looks along the motion as it did, and 0 where it does not. The rate is a mean over
the surface around each pixel, because all of that moves together. What comes nearer or goes away does not do so evenly:
the faster it does, the fewer frames it rests on. The past is mixed in after the last average over the
image, so that the map is not blurred again and again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfgpu.contract import Array, Device, Scalar, Streaming
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.matching.visible_sweep import VisibleSweep
from lfgpu.methods.measured import Measured
from lfgpu.methods.temporal_prior import TemporalPrior

_SAME = 0.5  # least `same` of a pixel whose past surface hides what lies behind it
_RATE_GAIN = 0.15  # share of the difference from the expected map that goes into its rate of change
_STEADY = 0.05  # rate of change that halves the weight of earlier frames, in units of `TemporalPrior.support`
_NO_RATE = 0.05  # weight of a rate of 0 in the mean over a surface


class TemporalMatching(MatchingPlan):
    """Matching that may start from the frame before, with all memory allocated.

    A cold frame knows nothing of the past, a warm one begins with the last map. Each makes its map the past of the next
    frame.

    Parameters
    ----------
    layout, measured, config, device
        As for `MatchingPlan`; `alignment.iterations` is the most steps that a frame may take.
    streaming
        The kernels that only streams need.
    prior
        How much the last map says.
    """

    may_be_masked = True

    def __init__(
        self,
        layout: ViewLayout,
        measured: Measured,
        config: MatchingConfig,
        device: Device,
        *,
        streaming: Streaming,
        prior: TemporalPrior,
    ) -> None:
        kernels = device.kernels
        super().__init__(layout, measured, config, device)
        past = self._resweep
        if past is None:
            offsets, nearest = device.field(self._few_offsets), device.zeros(self._few_shape[:3])
            past = VisibleSweep(self._sweep, self._few_shape, offsets, nearest, kernels, reaches=(self._reach,))
        self._past_cost = self._first_cost if self._resweep is None else self._last_cost
        self._sweep_past = past
        self._temporal, self._streaming, self._is_warm = prior, streaming, False
        self._past, self._frames, self._rate = (device.zeros(layout.size) for _ in range(3))
        self._expected, self._frames_before, self._rate_before = (device.zeros(layout.size) for _ in range(3))
        self._same, self._believed = (device.zeros(layout.size) for _ in range(2))
        self._farthest_surface = device.field(np.full(layout.size, self._bounds[0]))
        self._last_image = device.zeros_image((*layout.size, layout.channels))
        self._motion = streaming.motion(self._last_image)

    @property
    def noise(self) -> float:
        """How much views differ where they agree, intensity."""
        return self._noise

    @property
    def numbers(self) -> tuple[Scalar, Scalar]:
        """How much texture there was, 0 if none; and the size of the first step, NaN if something was not finite."""
        return self._trust, self._moves[0]

    @property
    def state(self) -> dict[str, Array]:
        """What a frame leaves for the next one, by name."""
        return {
            "past": self._past,
            "frames": self._frames,
            "rate": self._rate,
            "confidence": self.confidence,
            "last_image": self._last_image,
        }

    def mask(self, valid: Array | None) -> None:
        """Which pixels of the used views count from now on, a field [n, y, x]; None if all do."""
        self._valid = valid

    @property
    def levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """(steps, work) for a frame on its own, from the least to the most work."""
        steps = range(1, self._config.alignment.iterations + 1)
        quick = [(1, lambda views: self.cold(views, 1, again=False))] if self._resweep is not None else []
        return (*quick, *((n, lambda views, n=n: self.cold(views, n, again=True)) for n in steps))

    @property
    def warm_levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """The same for a frame that starts from the map before."""
        steps = range(1, self._config.alignment.iterations + 1)
        return tuple((n, lambda views, n=n: self.warm(views, n)) for n in steps)

    def cold(self, views: Array, steps: int, *, again: bool) -> None:
        """The map of `views` [n, y, x, c] alone, by `steps` of the alignment; compared again only if `again`."""
        self._is_warm, self._steps = False, steps
        self._compare(views)
        if self._resweep is not None and again:
            self._compare_visible(None)
        elif self._resweep is not None:
            self._kernels.copy(self._swept, self._matched)
        self._improve(None)
        self._complete()
        self._remember()
        self._leave_unknown()

    def warm(self, views: Array, steps: int) -> None:
        """A map of `views` that starts from the last one: the views that saw that are those that are compared, once."""
        kernels = self._kernels
        self._is_warm, self._steps = True, steps
        self._load(views, first=self._resweep is None)
        tolerance = self._temporal.tolerance * self.noise
        self._motion.find(self._image, self._last_image, tolerance=tolerance, same_out=self._same)
        self._motion.carry(
            self._past,
            self._frames,
            self._rate,
            self.confidence,
            support=self._temporal.support / self._farthest,
            past_out=self._expected,
            frames_out=self._frames_before,
            rate_out=self._rate_before,
            confidence_out=self._believed,
        )
        kernels.clamp(self._expected, *self._bounds, self._expected)
        kernels.multiply(self._same, self._believed, self._believed)
        # A surface that is not there any more hides nothing.
        kernels.threshold(self._same, _SAME, self._workspace)
        kernels.select(self._workspace, self._expected, self._farthest_surface, self._workspace)
        self._sweep_past(self._workspace, self._volume, reach=self._reach, cost=self._past_cost)
        self._find_surface(self._swept, again=True)
        if self._resweep is not None:
            kernels.copy(self._swept, self._matched)
        self._improve(None)
        self._complete()
        self._remember()
        self._leave_unknown()

    def _remember(self) -> None:
        copy = self._kernels.copy
        copy(self.disparity, self._past)
        copy(self._image, self._last_image)

    def _expect(self, costs: Array) -> None:
        semi_global = self._config.semi_global
        strength = self._temporal.strength * semi_global.resweep_factor * semi_global.large_penalty
        if self._is_warm and strength > 0:
            self._streaming.bias(
                self._expected,
                self._believed,
                costs,
                first=self._first,
                step=self._step,
                strength=strength,
                reach=self._temporal.reach,
            )

    def _unhidden_evidence(self) -> Array | None:
        return None if self._is_warm else super()._unhidden_evidence()

    def _judge(self) -> None:
        if self._is_warm and self._temporal.persistence > 0:
            support = self._temporal.support / self._farthest
            rates, weights = self._slope, self._curvature  # which are not needed any more
            self._streaming.blend(
                self._expected,
                self._same,
                self._frames_before,
                self._rate_before,
                self.disparity,
                persistence=self._temporal.persistence,
                support=support,
                steady=_STEADY * support,
                rate_gain=_RATE_GAIN,
                frames_out=self._frames,
                rates_out=rates,
                weights_out=weights,
            )
            self._prior.ratio(self.disparity, rates, weights, support=support, floor=_NO_RATE, ratio_out=self._rate)
        else:
            self._kernels.fill(1.0, self._frames)
            self._kernels.fill(0.0, self._rate)
        super()._judge()
