"""`StreamResult`: the map of one frame of a stream, or its error."""

from __future__ import annotations

import threading
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float32Array, Float64Array
from lfgpu.errors import LfgpuError


class FrameDroppedError(LfgpuError):
    """Error of a frame that was dropped, because frames came too fast or the stream was closed."""


class StreamResult:
    """Result of one frame. At first it is pending; then it holds a map and a confidence, or an error.

    Attributes
    ----------
    index
        Number of the frame, from 0, in the order of `push`.
    tag
        The `tag` that was given to `push`, such as a time stamp.
    cold
        True if the map was estimated without the previous one. `cut` is True if a change of the scene was the reason.
    steps
        Number of alignment steps.
    latency
        Seconds from `push` to the map on the host; NaN until then. `work` is the device time, seconds.
    stamps
        float64 [n], time of each picture, seconds, as given to `push`; NaN where a camera has none. None if they
        were not given.
    """

    def __init__(self, index: int, tag: Any, valid: NDArray[np.bool_]) -> None:
        self.index, self.tag, self.valid = index, tag, valid
        self.stamps: Float64Array | None = None
        self.cold, self.cut, self.steps = True, False, 0
        self.latency = self.work = float("nan")
        self._pushed, self._ready = perf_counter(), threading.Event()
        self._error: LfgpuError | None = None
        self._lease: Any = None

    @property
    def done(self) -> bool:
        """True if there is a map or an error."""
        return self._ready.is_set()

    @property
    def dropped(self) -> bool:
        """True if the frame was dropped."""
        return isinstance(self._error, FrameDroppedError)

    @property
    def error(self) -> LfgpuError | None:
        """The reason that there is no map; None if there is one, or if the result is pending."""
        return self._error

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until `done`, at most `timeout` seconds (None: no limit). Returns `done`."""
        return self._ready.wait(timeout)

    def numpy(self) -> Float32Array:
        """Copy the disparity, float32 [y, x], pixels per view step. Waits; raises `error` if there is one."""
        return np.asarray(self._maps().numpy(0))

    def confidence(self) -> Float32Array:
        """Copy the confidence, float32 [y, x], 0 to 1. Waits and raises as `numpy`."""
        return np.asarray(self._maps().numpy(1))

    @property
    def device_disparity(self) -> Any:
        """The disparity in device memory, with DLPack and `__cuda_array_interface__`; not copied.

        Waits and raises as `numpy`. The memory belongs to this frame while this result, or an array made from it,
        exists. After that a later frame reuses it. So wait until your reads have finished before you drop the result.
        """
        return self._maps().shared(0)

    @property
    def device_confidence(self) -> Any:
        """The confidence in device memory; as `device_disparity`."""
        return self._maps().shared(1)

    def _maps(self) -> Any:
        self._ready.wait()
        if self._error is not None:
            raise self._error
        return self._lease

    def _finish(self, lease: Any) -> None:
        self._lease = lease
        self._ready.set()

    def _fail(self, error: LfgpuError) -> None:
        self._error = error
        self._ready.set()


OnResult = Callable[[StreamResult], None]
"""Called with each result, from a thread of the stream."""
