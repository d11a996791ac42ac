"""Watches over a stream: its disparity range, time stamps of cameras that do not record together, and its errors."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, open_device
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.pipelines.stream_result import StreamResult
from lfgpu.pipelines.verdict import at_ends
from lfgpu.threads import alone_here

_BEYOND = 0.25  # of the found range, beyond an end: more than the found one has as a margin
_BEYOND_IF_SUSPECTED = 0.05
_PAUSE = 10.0  # seconds between two searches

_LOG = logging.getLogger(__name__)


class RangeWatch:
    """Watch over the disparity range of a stream; it says once for each end that it is too small, found or given.

    Maps are clamped to the range, so surfaces beyond it often lie exactly at one of its ends. But surfaces without
    texture may lie there by chance, and those with texture may take any other disparity. So the ends of the maps only
    raise a suspicion; the views decide, by the range that is found in them.
    """

    def __init__(self, bounds: tuple[float, float], first: LightField | None = None) -> None:
        self._bounds, self._first = bounds, first
        self._said: dict[str, str] = {}
        self._suspected: dict[str, float] = {}  # share of the map at each end, since the last search
        self._changed = threading.Condition()
        self._wanted = self._closed = False
        self._next = -float("inf")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences so far, one for each end of the range."""
        return tuple(self._said.values())

    def look(self, disparity: Float32Array, *, is_new: bool) -> bool:
        """Look at a map [y, x], and ask for a search if need be; `is_new` says that the scene is another one.

        Returns True if many pixels of the map lie at one end of the range (`at_ends`).
        """
        beyond = at_ends(disparity, self._bounds)
        if is_new or beyond.keys() - self._said.keys():
            with self._changed:
                self._suspected |= beyond
                self._wanted = True
                self._changed.notify()
        return bool(beyond)

    def run(self, snapshot: Callable[[], tuple[LightField, StreamResult] | None], errors: FirstErrors) -> None:
        """Find the range in the first views, if there are any, and whenever it is wanted; the loop of a thread.

        `snapshot` waits for the views of a frame, `errors` takes exceptions. New sentences are logged.
        """
        lf, what, self._first = self._first, "the first views", None
        while True:
            try:
                new = () if lf is None else self.search(lf, what)
            except Exception as error:  # the maps do not need it
                errors.log("the disparity range of a frame could not be found", error)
                return
            for sentence in new:
                _LOG.warning(sentence)
            lf = None  # its memory is not needed any more
            shown = snapshot() if self.wait() else None
            if shown is None:
                return
            lf, what = shown[0], f"the views of frame {shown[1].index}"

    def wait(self) -> bool:
        """Wait until views are to be searched. False after `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self._wanted or self._closed)
            self._changed.wait_for(lambda: self._closed, max(0.0, self._next - monotonic()))
            return not self._closed

    def search(self, lf: LightField, what: str) -> tuple[str, ...]:
        """Find the range in views, which `what` names. Returns the sentences that are new."""
        with self._changed:
            self._next, self._wanted = monotonic() + _PAUSE, False
            suspected, self._suspected = self._suspected, {}
        try:
            with alone_here():  # the device and the other cores have frames to work on
                found = find_disparity_range(lf, open_device(DEFAULT, "cpu"))
        except LightFieldError:  # nothing in these views says how far away it is
            return ()
        (low, high), width = self._bounds, found[1] - found[0]
        new = {}
        for end, excess in (("far", low - found[0]), ("near", found[1] - high)):
            bound = _BEYOND_IF_SUSPECTED if end in suspected else _BEYOND
            if excess > bound * width and end not in self._said:
                new[end] = self._sentence(end, suspected.get(end), found, what)
        self._said |= new
        return tuple(new.values())

    def close(self) -> None:
        """End the watch: no search is wanted any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _sentence(self, end: str, share: float | None, found: tuple[float, float], what: str) -> str:
        low, high = self._bounds
        part = "" if share is None else f", and {100 * share:.0f} % of a map lies at its {end} end"
        return (
            f"The disparity range from {low:.3g} to {high:.3g} px per view step is too small for the frames: {what} "
            f"show about {found[0]:.3g} to {found[1]:.3g}{part}; move the {end} end further out."
        )


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
        self.warnings: tuple[str, ...] = ()
        """The sentence that was said, or nothing."""

    def look(self, index: int, stamps: Float64Array | None) -> bool:
        """Compare the stamps of a frame: True if they differ by too much. The sentence is logged, too."""
        if stamps is None or self._tolerance is None:
            return False
        used = stamps[self._used]
        spread = float(np.nanmax(used) - np.nanmin(used))
        if spread <= self._tolerance or self.warnings:
            return spread > self._tolerance
        farthest = self._used[int(np.nanargmax(np.abs(used - np.nanmedian(used))))]
        self.warnings = (
            f"The pictures of frame {index} were taken within {1000 * spread:.3g} ms, and {1000 * self._tolerance:.3g} "
            f"are allowed; view {farthest} is farthest from the others: what moves has a wrong disparity. Trigger the "
            "cameras together, or group their pictures with FrameGrouper.",
        )
        _LOG.warning(self.warnings[0])
        return True


class FirstErrors:
    """Log of exceptions with their traceback; of those from one line of code, which all frames may raise, the first."""

    def __init__(self) -> None:
        self._known = set[tuple[object, ...]]()

    def log(self, what: str, error: BaseException) -> None:
        """Log an exception unless one of its kind from the same line was; `what` names the failure."""
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        kind = type(error), place and (place.tb_frame.f_code.co_filename, place.tb_lineno)
        if kind not in self._known:
            self._known.add(kind)
            _LOG.error("%s; the next ones like this are only counted", what, exc_info=error)
