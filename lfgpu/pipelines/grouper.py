"""`FrameGrouper`: frames of all cameras, from pictures of cameras that each have their own time stamps."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfgpu.contract import Float64Array
from lfgpu.data.light_field_checks import check_positive, check_whole, checked_sides
from lfgpu.errors import LightFieldError

_OPEN = 8  # groups that are being filled at once: an older one is given out as it is
_SMOOTHING = 0.05  # weight of the latest picture in a camera's mean delay


@dataclass(frozen=True, eq=False)
class FrameGroup:
    """Pictures of all cameras that were taken at about the same time, for `DepthStream.push`."""

    views: NDArray[Any]  # [n, y, x, c]; 0 where a camera is missing
    valid: NDArray[np.bool_]  # bool [n], True for cameras with a picture
    stamps: Float64Array  # float64 [n], seconds, as the recorder gave them; NaN where a camera is missing

    @property
    def stamp(self) -> float:
        """The mean of the stamps, seconds."""
        return float(np.nanmean(self.stamps))


@dataclass(eq=False)
class _Open:
    """A group that is being filled; `filling` pictures are being copied into it."""

    first: float
    group: FrameGroup
    claimed: set[int] = field(default_factory=set)
    filling: int = 0


class FrameGrouper:
    """Grouper of pictures by their time stamps.

    Recorders add pictures from any thread and are never made to wait::

        grouper = lfgpu.FrameGrouper(9, (512, 640, 3), tolerance=0.004)
        # in the thread of each camera:
        grouper.add(camera, picture, stamp)
        # in another thread:
        for group in grouper:
            stream.push(group.views, valid=group.valid, stamps=group.stamps)

    A group is given out when all cameras are there, or when a picture comes that is `patience` younger: what is missing
    then is lost. Only stamps decide, no clock of this machine.

    Parameters
    ----------
    cameras
        Number of cameras, >= 2.
    shape
        (height, width, channels) of a picture.
    tolerance
        Seconds by which stamps of one group may differ at most, > 0; less than half the time between two frames.
    dtype
        Type of the pictures; default uint8.
    patience
        Seconds after a group's first stamp from which on a younger picture ends it, >= tolerance. Default None: four
        tolerances.
    waiting
        How many groups may wait to be taken, >= 1; then the oldest is dropped. Default 2.

    Raises
    ------
    LightFieldError
        If a number is out of its range.

    Examples
    --------
    >>> grouper = lfgpu.FrameGrouper(2, (4, 5), tolerance=0.004)
    >>> [grouper.add(camera, np.zeros((4, 5), np.uint8), stamp) for camera, stamp in ((0, 1.000), (1, 1.002))]
    [True, True]
    >>> grouper.get().views.shape
    (2, 4, 5)
    """

    def __init__(
        self,
        cameras: int,
        shape: tuple[int, int, int],
        *,
        tolerance: float,
        dtype: DTypeLike = np.uint8,
        patience: float | None = None,
        waiting: int = 2,
    ) -> None:
        check_positive("tolerance", tolerance, "seconds")
        patience = 4 * tolerance if patience is None else patience
        check_positive("patience", patience, "seconds")
        check_whole("cameras", cameras, 2)
        check_whole("waiting", waiting, 1)
        if patience < tolerance:
            raise LightFieldError(f"patience must be at least the tolerance, {tolerance} s, not {patience} s.")
        self._shape = checked_sides("shape", shape, "(height, width, channels) or (height, width)", least=2, most=3)
        self._count, self._dtype = cameras, np.dtype(dtype)
        self._tolerance, self._patience = tolerance, patience
        self._changed = threading.Condition()
        self._open: deque[_Open] = deque()
        self._ready: deque[FrameGroup] = deque()
        self._most = waiting
        self._done = -math.inf  # stamps up to here belong to groups that were given out
        self._closed = False
        self._counts = dict.fromkeys(("groups", "complete", "dropped", "lost", "late", "repeated"), 0)
        self._delays = np.zeros(cameras)

    def add(self, camera: int, picture: ArrayLike, stamp: float) -> bool:
        """Add a picture; it is copied. Never waits for another picture, or for whoever takes groups.

        Parameters
        ----------
        camera
            Its index.
        picture
            [y, x, c], or [y, x] if there is one channel, of the grouper's shape and type.
        stamp
            When it was taken, seconds, on a clock that all cameras share.

        Returns
        -------
        True if the picture became a part of a group; False if it came too late, or if its camera is in that group
        already.

        Raises
        ------
        LightFieldError
            If the camera, the shape or type, or the stamp is wrong.
        """
        values = np.asarray(picture)
        check_whole("camera", camera, 0, self._count - 1)
        if values.size != math.prod(self._shape) or values.shape not in (self._shape, self._shape[:2]):
            raise LightFieldError(
                f"the picture of camera {camera} must be {list(self._shape)}; found {list(values.shape)}."
            )
        if values.dtype != self._dtype:
            raise LightFieldError(f"the picture of camera {camera} must be {self._dtype}; found {values.dtype}.")
        if not isinstance(stamp, Real) or not math.isfinite(stamp):
            raise LightFieldError(f"the stamp of camera {camera} must be a number of seconds, not {stamp!r:.60}.")
        with self._changed:
            chosen = self._group_for(camera, stamp)
            if chosen is None:
                return False
            chosen.claimed.add(camera)
            chosen.filling += 1
        chosen.group.views[camera] = values.reshape(self._shape)
        with self._changed:
            chosen.group.valid[camera] = True
            chosen.group.stamps[camera] = stamp
            chosen.filling -= 1
            self._delays[camera] += _SMOOTHING * (stamp - chosen.first - self._delays[camera])
            self._give_out()
        return True

    def get(self, timeout: float | None = None) -> FrameGroup | None:
        """Wait for the oldest group and take it; None if none came within `timeout` seconds, or after `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self._ready or (self._closed and not self._open), timeout)
            return self._ready.popleft() if self._ready else None

    def __iter__(self) -> Iterator[FrameGroup]:
        """Groups as they come, until `close`."""
        while (group := self.get()) is not None:
            yield group

    def close(self) -> None:
        """Give out what there is, and end the iteration once it is taken. Later pictures are late."""
        with self._changed:
            self._closed = True
            self._give_out()
            self._changed.notify_all()

    def stats(self) -> dict[str, Any]:
        """Counts, and how the clocks of the cameras stand to each other.

        Returns
        -------
        `groups` given out, of which `complete` had all cameras and `dropped` were not taken in time; pictures that were
        `lost` (missing in a group that was given out), `late` (their group was given out before) and `repeated` (a
        second picture of a camera in one group); `delays`, seconds by which each camera's stamps lie after the mean of
        all, smoothed: a clock that drifts is seen here before pictures are lost.
        """
        with self._changed:
            return {**self._counts, "delays": (self._delays - self._delays.mean()).tolist()}

    # --- steps; the caller holds the lock ---

    def _group_for(self, camera: int, stamp: float) -> _Open | None:
        """Find the group of a picture, or open one; None if the picture may not be in any."""
        near = [group for group in self._open if abs(stamp - group.first) <= self._tolerance]
        if near:
            chosen = min(near, key=lambda group: abs(stamp - group.first))
            if camera not in chosen.claimed:
                return chosen
            self._counts["repeated"] += 1
            return None
        if stamp <= self._done or self._closed:
            self._counts["late"] += 1
            return None
        views = np.zeros((self._count, *self._shape), self._dtype)
        group = FrameGroup(views, np.zeros(self._count, np.bool_), np.full(self._count, np.nan))
        opened = _Open(stamp, group)
        # In the order of their stamps, whatever the order in which they come.
        place = sum(other.first < stamp for other in self._open)
        self._open.insert(place, opened)
        return opened

    def _give_out(self) -> None:
        """Give out the oldest groups, as far as they are complete or overdue; all of them when closed."""
        while self._open:
            oldest = self._open[0]
            youngest = self._open[-1].first
            complete = len(oldest.claimed) == self._count
            overdue = youngest - oldest.first >= self._patience or len(self._open) > _OPEN
            if oldest.filling or not (complete or overdue or self._closed):
                return
            self._open.popleft()
            self._done = max(self._done, oldest.first + self._tolerance)
            self._counts["groups"] += 1
            self._counts["complete"] += complete
            self._counts["lost"] += self._count - len(oldest.claimed)
            self._ready.append(oldest.group)
            if len(self._ready) > self._most:
                self._ready.popleft()
                self._counts["dropped"] += 1
            self._changed.notify_all()
