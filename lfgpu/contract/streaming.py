"""An optional capability of a backend: frames that come and maps that go while the device works."""

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array, Float32Array, Scalar

Maps: TypeAlias = Any
"""Memory for the results of one frame, of whatever type the backend uses."""


class Slot(Protocol):
    """Memory for a frame that waits for its turn."""

    host: NDArray[Any]  # the views [n, y, x, c], as stored, in memory of the host

    present: NDArray[np.float32]  # presence of the views, 1 or 0, [n]


class Lease(Protocol):
    """The results of one frame in somebody's hands. When nobody holds it any more, its memory is used again."""

    def shared(self, index: int) -> Any:
        """Disparity (0) or confidence (1) for other libraries, as `Memory.shared`."""

    def numpy(self, index: int) -> Float32Array:
        """Return a copy of the same in memory of the host, float32 [y, x]."""


class Transport(Protocol):
    """The traffic of one stream. Each thread that asks the device, or waits for it, calls `enter` once."""

    made: int  # number of results that there is memory for

    def enter(self) -> None:
        """Prepare the calling thread for the device."""

    def slot(self) -> Slot:
        """Room for one more waiting frame."""

    def take(self, values: Any, slot: Slot, views: list[int] | None) -> None:
        """Copy an array of another library on the same device into a slot, in the order of that library's stream."""

    def send(self, slot: Slot, first: int, last: int) -> None:
        """Send the views from `first` to before `last`, which are in the slot's `host`, to the device meanwhile.

        Views that are neither sent nor taken are those of an earlier frame.
        """

    def bring(self, slot: Slot) -> tuple[float, float]:
        """Take a frame to the device.

        Returns which share of the samples of the reference view changed, and which share is far outside [0, 1], both 0
        to 1. The device may still work on the frame before. The slot may be used again afterwards.
        """

    def mask(self, base: Array | None, mask_out: Array) -> None:
        """mask [n, y, x] = whether view n of the frame brought last is there, times `base` unless that is None."""

    def captured(self, work: Callable[[], None]) -> Callable[[], None]:
        """Work as one graph of the device, if it has graphs; else `work` itself. It must have run once before."""

    def solve(self, work: Callable[[], None], before: Callable[[], None] | None) -> Maps:
        """Ask for a map of the frame that was brought last: `before`, if given, and `work`. The maps come later."""

    def wait(self, maps: Maps) -> tuple[float, float, float]:
        """Wait until maps are on the host: seconds that the device worked on them, and the method's two numbers."""

    def lease(self, maps: Maps) -> Lease:
        """Maps for somebody to hold."""

    def give(self, maps: Maps) -> None:
        """Maps that nobody will hold."""

    def synchronize(self) -> None:
        """Wait for all that was asked for."""


class Motion(Protocol):
    """The motion of what the reference view shows, from the last frame to this one: p now was at p + w."""

    def find(self, image: Array, last: Array, *, tolerance: float, same_out: Array) -> None:
        """Find w for each pixel, from two images [y, x, c].

        same_out = 1 / (1 + (m / t)^8) [y, x]. m is the mean change of intensity along w over 3 x 3 pixels and the
        channels. t is `tolerance` where w = 0. Elsewhere it grows with the gradients of the image: w is not exact.
        """

    def carry(
        self,
        past: Array,
        frames: Array,
        rate: Array,
        confidence: Array,
        *,
        support: float,
        past_out: Array,
        frames_out: Array,
        rate_out: Array,
        confidence_out: Array,
    ) -> None:
        """Carry fields [y, x] of the last frame along the motion: each output is its input at p + w.

        That is the mean of the four pixels around, weighted linearly, without those whose `past` differs by more than
        `support` from that of the nearest one. past_out is the map that is expected now: past + rate.
        """


class Streaming(Protocol):
    """Operations of streams, beyond those of a single estimate."""

    def transport(
        self,
        views: Array,
        sources: tuple[Array, Array, Scalar, Scalar],
        *,
        reference: int,
        scale: float,
        tolerance: float,
        results: int,
    ) -> Transport:
        """Plan the traffic of one stream.

        Parameters
        ----------
        views
            What the method reads, [n, y, x, c] as stored.
        sources
            Disparity and confidence, fields [y, x], and two numbers of the method.
        reference, scale, tolerance
            Index of the reference view; the factor from stored values to intensities; the mean difference over the
            channels, intensity, from which on a sample has changed.
        results
            How many results there is memory for at first.
        """

    def motion(self, image: Array) -> Motion:
        """Plan the motion in images like `image` [y, x, c], float32."""

    def bias(
        self, past: Array, trust: Array, volume: Array, *, first: float, step: float, strength: float, reach: float
    ) -> None:
        """volume [l, y, x] += strength * trust * min(|first + l step - past| / step, reach) / reach."""

    def blend(
        self,
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
        """Average the expected map `past`, which rests on `frames` frames, and the map of now; fields [y, x].

        With e = disparity - past, s = same / (1 + (e / support)^4) and
        b = persistence s frames / (1 + (rate / steady)^2), disparity = past + e / (1 + b) and frames_out = 1 + b. What
        is known about the change from frame to frame is rates_out = weights_out (rate + rate_gain e),
        weights_out = s b / (1 + b).
        """
