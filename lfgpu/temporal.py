"""What one frame of a stream leaves for the next: where surfaces were, for how long, and what they looked like.

Three things come from the last map. The views that saw its surfaces are those that are compared, which spares the first
sweep. Costs get strength * same * confidence * min(|d - past|, reach) / reach on top, so that what looks alike at
several disparities does not jump between them. And the new map is averaged with the old one, pixel by pixel: with the
number of frames that went into a pixel so far,

    before = persistence * same * frames / (1 + ((past - d) / support)^4),   d <- (d + before past) / (1 + before),
    frames <- 1 + before,

which is a Kalman filter whose measurements are all as good as each other. `same` is 1 where the reference view looks
as it did, 0 where it does not. The past is mixed in after the last average over the image, so that nothing is blurred
again and again.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

from lfgpu.config import Config
from lfgpu.errors import LightFieldError
from lfgpu.lightfield import LightField
from lfgpu.matching import Matching
from lfgpu.types import Array, KernelSet, Scalar

_RANGES = {
    "persistence": (0, 0.99),
    "strength": (0, 10),
    "reach": (0.5, 100),
    "tolerance": (0.5, 100),
    "support": (1e-3, 100),
}


@dataclass(frozen=True)
class TemporalPrior:
    """How much the last map says about the next one. LightFieldError where a value is out of range.

    Parameters
    ----------
    persistence
        Share of the frames so far that still count one frame later where nothing changed, 0 to 0.99: in the long run
        1 / (1 - persistence) frames are averaged. Default 0.8.
    strength
        Cost of being far from the last map, in units of `matching.large_step`; 0 to 10, default 0.5.
    reach
        Distance from which on that cost stays the same, in steps of the sweep; 0.5 to 100, default 2.
    tolerance
        Mean change of intensity, over 3 x 3 pixels, that makes a pixel half trusted; in units of the noise of the
        views, 0.5 to 100, default 1.5.
    support
        Difference to the last map that halves how much of it is kept, pixels in the farthest view; 0.001 to 100,
        default 0.4.
    """

    persistence: float = 0.8
    strength: float = 0.5
    reach: float = 2.0
    tolerance: float = 1.5
    support: float = 0.4

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not low <= float(value) <= high:
                raise LightFieldError(f"{name} of the temporal prior must lie in {low:g} to {high:g}, not {value!r}.")


class TemporalMatching(Matching):
    """Matching that may start from the frame before; everything is allocated when it is made.

    `cold` is what `stages` does, and knows nothing of the past; `warm` begins with the last map. Each makes its map the
    past of the next frame.

    Parameters
    ----------
    lf, bounds, config, kernels, device
        As for `Matching`; `alignment.iterations` is the most steps that a frame may take.
    prior
        How much the last map says.
    live
        The module of kernels that only streams have.
    """

    def __init__(
        self,
        lf: LightField,
        bounds: tuple[float, float],
        config: Config,
        kernels: KernelSet,
        device: str,
        *,
        prior: TemporalPrior,
        live: Any,
    ) -> None:
        super().__init__(lf, bounds, config, kernels, device)
        # What compares only once has no use for it otherwise.
        shape = (*self._nearest.shape, lf.channels)
        self._past_hiding = self._hiding or kernels.nearest_surface(shape, self._offsets, reach=0)
        self._temporal, self._live, self._is_warm = prior, live, False
        self._past, self._frames, self._same, self._believed = (kernels.zeros(lf.size, device) for _ in range(4))
        self._last_image = kernels.zeros_image((*lf.size, lf.channels), device)

    @property
    def noise(self) -> float:
        """How much views differ where they agree, intensity."""
        return self._config.sweep.noise

    @property
    def numbers(self) -> tuple[Scalar, Scalar]:
        """How much texture there was, 0 if none; and the size of the first step, NaN if something was not finite."""
        return self._trust, self._moves[0]

    def mask(self, valid: Array | None) -> None:
        """Which pixels of the used views count from now on, a field [n, y, x]; None if all do."""
        self._valid = valid

    def cold(self, views: Array, steps: int, *, twice: bool) -> None:
        """The map of `views` [n, y, x, c] alone, by `steps` of the alignment; compared again only if `twice`."""
        self._is_warm, self._steps = False, steps
        self._compare(views)
        if self._twice and twice:
            self._compare_seen(None)
        elif self._twice:
            self._kernels.copy(self._swept, self._matched)
        self._improve(None)
        self._settle(None)
        self._remember()

    def warm(self, views: Array, steps: int) -> None:
        """A map of `views` that starts from the last one: the views that saw that are those that are compared, once."""
        kernels = self._kernels
        self._is_warm, self._steps = True, steps
        self._load(views)
        tolerance = self._temporal.tolerance * self.noise
        self._live.sameness(self._image, self._last_image, tolerance=tolerance, same_out=self._same)
        kernels.multiply(self._same, self.confidence, self._believed)
        self._past_hiding(self._past, self._nearest)
        self._sweep.seen(self._nearest, self._volume)
        self._find_surface(self._swept)
        if self._twice:
            kernels.copy(self._swept, self._matched)
        self._improve(None)
        self._settle(None)
        self._remember()

    def _remember(self) -> None:
        copy = self._kernels.copy
        copy(self.disparity, self._past)
        copy(self._image, self._last_image)

    def _expect(self, costs: Array) -> None:
        strength = self._temporal.strength * self._config.matching.large_step
        if self._is_warm and strength > 0:
            self._live.bias(
                self._past,
                self._believed,
                costs,
                first=self._first,
                step=self._step,
                strength=strength,
                reach=self._temporal.reach,
            )

    def _judge(self) -> None:
        if self._is_warm and self._temporal.persistence > 0:
            self._live.blend(
                self._past,
                self._same,
                self._frames,
                self.disparity,
                persistence=self._temporal.persistence,
                support=self._temporal.support / self._farthest,
            )
        else:
            self._kernels.fill(1.0, self._frames)
        super()._judge()
