"""Intake of frames into a stream: they are checked, and copied to the memory where they wait for the device."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.streaming import Slot, Transport
from lfgpu.data import LightField, interop
from lfgpu.data.light_field_checks import check_scaled
from lfgpu.errors import LightFieldError
from lfgpu.threads import get_threads

_AT_ONCE = 2**22  # bytes: up to this size, one thread copies as fast as several
_MOST_COPIERS = 8


class Intake:
    """Intake of frames of the kind of a light field, from any thread; only `used` views are read."""

    def __init__(self, lf: LightField, used: Sequence[int], device: str) -> None:
        self._expected, self._grid = (lf.views.shape, lf.views.dtype), lf.grid_shape
        self._used, self._all, self._reference = list(used), len(used) == len(lf.views), lf.reference_index
        self._device = device
        self._copying = max(1, min(_MOST_COPIERS, get_threads(), len(self._used)))
        self._copiers = ThreadPoolExecutor(self._copying, thread_name_prefix="lfgpu-copy")

    @property
    def count(self) -> int:
        """Number of views of a frame."""
        return int(self._expected[0][0])

    def close(self) -> None:
        """End the threads that copy; no frame comes any more."""
        self._copiers.shutdown()

    def checked_valid(self, valid: Any) -> NDArray[np.bool_]:
        """Check the mask of the cameras with a picture, bool [n]; LightFieldError if it is none."""
        there = np.asarray(valid)
        if there.shape != self._expected[0][:1] or there.dtype != np.bool_:
            raise LightFieldError(
                f"valid must be bool [{self._expected[0][0]}], one value for each view; found {there.dtype} "
                f"{list(there.shape)}."
            )
        if not there[self._reference]:
            raise LightFieldError(
                f"the reference view (index {self._reference}) is missing, but its disparity is estimated; give its "
                "picture."
            )
        if there[self._used].sum() < 2:
            raise LightFieldError("of the used views only the reference view is valid; depth needs at least one more.")
        return there

    def checked(self, frame: Any) -> tuple[Any, bool]:
        """Check a frame: [n, y, x, c], a NumPy array if it is on the host; and True if it is on the GPU.

        LightFieldError if it is of another kind; whatever the library of the frame raises.
        """
        place = interop.place_of("views", frame)
        found, shape = interop.kind_of("views", frame)
        expected, dtype = self._expected
        others = [expected[:3]] if expected[3] == 1 else []
        if self._grid is not None and self._grid[0] * self._grid[1] == expected[0]:
            others += [(*self._grid, *form[1:]) for form in (expected, *others)]
        if found != str(dtype) or shape not in (expected, *others):
            raise LightFieldError(
                f"views must be {dtype} {list(expected)}, like those that the stream was made for; found {found} "
                f"{list(shape)}."
            )
        if place == "cpu":
            return interop.on_host("views", frame).reshape(expected), False
        if self._device == "cpu" or place not in (self._device, interop.SOME_GPU):
            raise LightFieldError(f"views are on {place}, but the stream is on {self._device}; copy them there first.")
        if shape != expected:
            if not hasattr(frame, "reshape"):
                raise LightFieldError(f"views on a GPU must have the shape {list(expected)}; found {list(shape)}.")
            frame = frame.reshape(expected)
        return frame, True

    def fill(self, slot: Slot, frame: Any, valid: NDArray[np.bool_], transport: Transport, *, on_gpu: bool) -> None:
        """Copy a checked frame to its slot; copied views go to the device while the rest is copied."""
        slot.present[:] = valid[self._used]
        transport.enter()
        if on_gpu:
            transport.take(frame, slot, None if self._all else self._used)
            return

        def copy(place: int) -> None:
            view = self._used[place]
            if not valid[view]:
                slot.host[place] = 0  # the memory may hold NaN
                return
            slot.host[place] = frame[view]
            if frame.dtype.kind == "f":
                low, high = float(slot.host[place].min()), float(slot.host[place].max())
                if not np.isfinite(low + high):
                    raise LightFieldError(f"view {view} holds NaN or infinity; set valid[{view}] to False.")
                check_scaled(f"view {view}", low, high)

        whole = self._all and bool(valid.all()) and frame.dtype.kind != "f"

        def copy_some(first: int, last: int) -> None:
            if whole:
                slot.host[first:last] = frame[first:last]
                return
            for place in range(first, last):
                copy(place)

        count, parts = len(self._used), 1 if slot.host.nbytes < _AT_ONCE else self._copying
        cuts = [count * part // parts for part in range(parts + 1)]
        others = [self._copiers.submit(copy_some, *cuts[part : part + 2]) for part in range(1, parts)]
        try:
            copy_some(*cuts[:2])
            transport.send(slot, *cuts[:2])
            for part, other in enumerate(others, 1):
                other.result()
                transport.send(slot, *cuts[part : part + 2])
        finally:
            wait(others)  # the slot must not be returned before
