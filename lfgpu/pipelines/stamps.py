"""Time stamps of the cameras of a frame, and a watch over cameras that do not record together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError


def checked_stamps(stamps: Any, valid: NDArray[np.bool_]) -> Float64Array:
    """Check the stamps of all cameras: float64 [n], NaN where a camera has no picture; else LightFieldError."""
    try:
        found = np.array(stamps, np.float64)
    except (TypeError, ValueError) as error:
        raise LightFieldError("stamps must be numbers of seconds, one for each view.") from error
    if found.shape != valid.shape:
        raise LightFieldError(f"stamps must be [{len(valid)}], one for each view; found {list(found.shape)}.")
    if not np.isfinite(found[valid]).all():
        first = int(np.flatnonzero(valid & ~np.isfinite(found))[0])
        raise LightFieldError(
            f"the stamp of view {first} is {found[first]}; give seconds, or set valid[{first}] to False."
        )
    found[~valid] = np.nan
    return found


class StampWatch:
    """Watch over the stamps of a stream's frames; it says once if `used` cameras are more than the tolerance apart."""

    def __init__(self, tolerance: float | None, used: Sequence[int]) -> None:
        self._tolerance, self._used = tolerance, list(used)
        self._said: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentence that was said, or nothing."""
        return self._said

    def look(self, index: int, stamps: Float64Array | None) -> tuple[bool, tuple[str, ...]]:
        """Compare the stamps of a frame: True if they differ by too much, and the sentences that are new."""
        if stamps is None or self._tolerance is None:
            return False, ()
        used = stamps[self._used]
        spread = float(np.nanmax(used) - np.nanmin(used))
        if spread <= self._tolerance or self._said:
            return spread > self._tolerance, ()
        farthest = self._used[int(np.nanargmax(np.abs(used - np.nanmedian(used))))]
        self._said = (
            f"The pictures of frame {index} were taken within {1000 * spread:.3g} ms, and {1000 * self._tolerance:.3g} "
            f"are allowed; view {farthest} is farthest from the others: what moves has a wrong disparity. Trigger the "
            "cameras together, or group their pictures with FrameGrouper.",
        )
        return True, self._said
