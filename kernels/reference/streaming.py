"""The operations of streams, without a device: a frame is there as soon as it comes."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array as Array

from .motion import motion

__all__ = ["bias", "blend", "motion", "transport"]


SAMPLES = 64  # along each side of the reference view, that are looked at for cuts
LOWEST, HIGHEST = -0.5, 1.5  # intensities beyond these are in another unit


def bias(past: Array, trust: Array, volume: Array, *, first: float, step: float, strength: float, reach: float) -> None:
    labels = first + step * np.arange(len(volume))[:, None, None]
    volume += strength * trust * np.minimum(np.abs(labels - past) / step, reach) / reach


def blend(
    past: Array,
    same: Array,
    frames: Array,
    rate: Array,
    disparity: Array,
    *,
    persistence: float,
    support: float,
    steady: float,
    rate_gain: float,
    frames_out: Array,
    rates_out: Array,
    weights_out: Array,
) -> None:
    innovation = disparity - past
    goes_on = same / (1 + (innovation / support) ** 4)
    before = persistence * goes_on * frames / (1 + (rate / steady) ** 2)
    disparity[:] = past + innovation / (1 + before)
    weights_out[:] = goes_on * before / (1 + before)
    rates_out[:] = weights_out * (rate + rate_gain * innovation)
    frames_out[:] = 1 + before


class Slot:
    """Memory for a frame that waits."""

    def __init__(self, views: Array) -> None:
        self.host = np.zeros(views.shape)
        self.present = np.ones(len(views), np.float32)


class Maps:
    """The results of one frame: copies of both maps and both numbers, and the seconds that they took."""

    def __init__(self, sources: tuple[Array, ...], seconds: float) -> None:
        self.disparity, self.confidence, self.trust, self.moved = (source.copy() for source in sources)
        self.seconds = seconds

    def shared(self, index: int) -> Array:
        return (self.disparity, self.confidence)[index]

    def numpy(self, index: int) -> NDArray[np.float32]:
        return self.shared(index).astype(np.float32)


class transport:
    """The traffic of one stream (`lfgpu.contract.streaming.Transport`)."""

    def __init__(
        self,
        views: Array,
        sources: tuple[Array, Array, Array, Array],
        *,
        reference: int,
        scale: float,
        tolerance: float,
        results: int,
    ) -> None:
        self._views, self._sources, self.made = views, sources, results
        self._reference, self._scale, self._tolerance = reference, scale, tolerance
        self._present, self._last = np.ones(len(views)), np.zeros(self._samples().shape)

    def _samples(self) -> Array:
        """Samples of the reference view, [j, i, c], each in the middle of a block of pixels."""
        image = self._views[self._reference]
        down, across = (max(1, size // SAMPLES) for size in image.shape[:2])
        return image[down // 2 :: down, across // 2 :: across]

    def enter(self) -> None:
        pass

    def slot(self) -> Slot:
        return Slot(self._views)

    def take(self, values: Any, slot: Slot, views: list[int] | None) -> None:
        slot.host[:] = np.asarray(values) if views is None else np.asarray(values)[views]

    def send(self, slot: Slot, first: int, last: int) -> None:
        pass

    def bring(self, slot: Slot) -> tuple[float, float]:
        self._views[:], self._present[:] = slot.host, slot.present
        now = self._samples()
        changed = ~(self._scale * np.abs(now - self._last).mean(2) <= self._tolerance)
        outside = ((self._scale * now < LOWEST) | (self._scale * now > HIGHEST)).any(2)
        self._last[:] = now
        down, across = (-(-size // max(1, size // SAMPLES)) for size in self._views.shape[1:3])
        return float(changed.sum() / (down * across)), float(outside.sum() / (down * across))

    def mask(self, base: Array | None, mask_out: Array) -> None:
        mask_out[:] = self._present[:, None, None] * (1 if base is None else base)

    def captured(self, work: Callable[[], None]) -> Callable[[], None]:
        return work

    def solve(self, work: Callable[[], None], before: Callable[[], None] | None) -> Maps:
        if before is not None:
            before()
        start = time.perf_counter()
        work()
        return Maps(self._sources, time.perf_counter() - start)

    def wait(self, maps: Maps) -> tuple[float, float, float]:
        return maps.seconds, float(maps.trust[0]), float(maps.moved[0])

    def lease(self, maps: Maps) -> Maps:
        return maps

    def give(self, maps: Maps) -> None:
        pass

    def synchronize(self) -> None:
        pass
