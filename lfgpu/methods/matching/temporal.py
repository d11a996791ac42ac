"""Streams: each frame of matching may start from the map of the frame before.

First the motion of the reference view is found, and what is known of each surface moves along with it: its expected
disparity past + rate, the rate at which the disparity changes, and the number of frames on which it rests. The expected
map is used three times.

- The one sweep of the frame compares the views that should see the expected surfaces, which spares the first sweep.
  Where the reference view has changed, the expected surface hides nothing.
- Costs get strength * same * confidence * min(|d - past|, reach) / reach on top, so that a pixel that looks alike at
  several disparities does not jump between them.
- The new map is averaged with the expected one, pixel by pixel, as by a Kalman filter whose measurements are equally
  good: with the number of frames that went into a pixel so far,

      before = persistence * same * frames / (1 + ((past - d) / support)^4) / (1 + (rate / steady)^2),
      d <- (d + before past) / (1 + before),   frames <- 1 + before.

`same` is 1 where the reference view looks along the motion as it did, and 0 where it does not. The rate is a mean over
the surface around each pixel, because a surface moves as a whole. The faster a surface comes nearer or goes away, the
fewer frames it rests on, because it does not do so evenly. The past is mixed in after the last average over the image,
so that the map is not blurred again and again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfgpu.contract import Array, Device, Scalar, Streaming
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.measured import Measured
from lfgpu.methods.temporal_prior import TemporalPrior

_SAME = 0.5  # least `same` of a pixel whose past surface hides what lies behind it
_RATE_GAIN = 0.15  # share of the difference from the expected map that goes into its rate of change
_STEADY = 0.05  # rate of change that halves the weight of earlier frames, in units of `TemporalPrior.support`
_NO_RATE = 0.05  # weight of a rate of 0 in the mean over a surface


class TemporalMatching(MatchingPlan):
    """Matching that may start from the frame before, with all memory allocated.

    A cold frame knows nothing of the past, a warm one begins with the last map. Each makes its map the past of the next
    frame. `alignment.iterations` is the most steps that a frame may take.
    """

    is_live = True

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
        super().__init__(layout, measured, config, device)
        arena, size = self._arena, self._frame.size
        self._temporal, self._streaming, self._is_warm = prior, streaming, False
        self._past, self._frames, self._rate = (arena.field(n, size) for n in ("past", "frames", "rate"))
        self._expected, self._frames_before, self._rate_before, self._same, self._believed = (
            arena.field(f"carried {n}", size) for n in ("past", "frames", "rate", "likeness", "confidence")
        )
        self._farthest_surface = arena.constant("farthest", np.full(size, self._frame.bounds[0]))
        self._last_image = arena.image("last image", (*size, layout.channels))
        self._motion = streaming.motion(self._last_image)
        with arena.scratch() as scratch:
            self._rates, self._weights = scratch.fields(2, size)
        self._hides = arena.field("expected surface", size)

    @property
    def numbers(self) -> tuple[Scalar, Scalar]:
        """The amount of texture, 0 if there was none; and the size of the first step, NaN if a value was not finite."""
        return self.trust, self._alignment.moves[0]

    @property
    def state(self) -> dict[str, Array]:
        """The arrays that a frame leaves for the next one, by name."""
        return {
            "past": self._past,
            "frames": self._frames,
            "rate": self._rate,
            "confidence": self.confidence,
            "last_image": self._last_image,
        }

    def mask(self, valid: Array | None) -> None:
        """Set the mask of the used views, a field [n, y, x]; None if all pixels are valid."""
        self._frame.valid = valid

    @property
    def levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """(steps, work) for a frame on its own, from the least to the most work."""
        steps = range(1, self._config.alignment.iterations + 1)
        quick = [(1, lambda views: self.cold(views, 1, again=False))] if self._sweeps.are_several else []
        return (*quick, *((n, lambda views, n=n: self.cold(views, n, again=True)) for n in steps))

    @property
    def warm_levels(self) -> tuple[tuple[int, Callable[[Array], None]], ...]:
        """The same for a frame that starts from the map before."""
        steps = range(1, self._config.alignment.iterations + 1)
        return tuple((n, lambda views, n=n: self.warm(views, n)) for n in steps)

    def cold(self, views: Array, steps: int, *, again: bool) -> None:
        """Estimate the map of `views` [n, y, x, c] alone, by `steps` of the alignment; sweep again only if `again`."""
        self._is_warm, self._steps = False, steps
        self._sweep(views)
        if self._sweeps.are_several and again:
            self._sweep_again(None)
        elif self._sweeps.are_several:
            self._kernels.copy(self._swept, self._matched)
        self._improve()

    def warm(self, views: Array, steps: int) -> None:
        """Estimate a map of `views` from the last one: one sweep compares the views that saw the last surfaces."""
        kernels = self._kernels
        self._is_warm, self._steps = True, steps
        self._frame.load(views)
        tolerance = self._temporal.tolerance * self.noise
        self._motion.find(self._frame.image, self._last_image, tolerance=tolerance, same_out=self._same)
        self._motion.carry(
            self._past,
            self._frames,
            self._rate,
            self.confidence,
            support=self._temporal.support / self._frame.layout.farthest,
            past_out=self._expected,
            frames_out=self._frames_before,
            rate_out=self._rate_before,
            confidence_out=self._believed,
        )
        kernels.clamp(self._expected, *self._frame.bounds, self._expected)
        kernels.multiply(self._same, self._believed, self._believed)
        # A surface that is not there any more hides nothing.
        kernels.threshold(self._same, _SAME, self._hides)
        kernels.select(self._hides, self._expected, self._farthest_surface, self._hides)
        self._sweeps.find(self._sweeps.past, self._hides, self._swept, self._expect)
        if self._sweeps.are_several:
            kernels.copy(self._swept, self._matched)
        self._improve()

    def _improve(self) -> None:
        """Do all that follows the sweeps, and make the map the past of the next frame."""
        self._align(None)
        self._complete()
        self._kernels.copy(self.disparity, self._past)
        self._kernels.copy(self._frame.image, self._last_image)
        self._put_unknown(self.disparity)

    def _expect(self, costs: Array) -> None:
        """Make disparities dearer that differ from the expected ones: change costs [l, y, x]."""
        config, disparities = self._config, self._frame.disparities
        strength = self._temporal.strength * config.tuning.semi_global.resweep_factor * config.semi_global.large_penalty
        if strength > 0:
            self._streaming.bias(
                self._expected,
                self._believed,
                costs,
                first=disparities.first,
                step=disparities.step,
                strength=strength,
                reach=self._temporal.reach,
            )

    @property
    def _unhidden(self) -> Array | None:
        return None if self._is_warm else super()._unhidden

    def _judge(self) -> None:
        if self._is_warm and self._temporal.persistence > 0:
            support = self._temporal.support / self._frame.layout.farthest
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
                rates_out=self._rates,
                weights_out=self._weights,
            )
            self._frame.prior.ratio(
                self.disparity, self._rates, self._weights, support=support, floor=_NO_RATE, ratio_out=self._rate
            )
        else:
            self._kernels.fill(1.0, self._frames)
            self._kernels.fill(0.0, self._rate)
        super()._judge()
