"""Where frames of a stream wait, and what happens to those for which there is no room."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from lfgpu.errors import LfgpuError

POLICIES = {"latest": 1, "block": 2, "queue": 4}
"""Names of the policies, and how many frames may wait unless it is said."""

Frame = TypeVar("Frame")
Slot = TypeVar("Slot")


class Inbox(Generic[Frame, Slot]):
    """Frames wait here in order, each with a slot that holds what it is made of; used from any threads.

    Parameters
    ----------
    policy
        "block" makes those who bring a frame wait until there is room; otherwise the oldest waiting frame makes room.
    waiting
        How many frames may wait, >= 1.
    slots
        What holds the frames; more than `waiting`, as one is filled and one is read meanwhile.
    drop
        Called with each frame that is given up, without any lock held.
    """

    def __init__(self, policy: str, waiting: int, slots: list[Slot], drop: Callable[[Frame], None]) -> None:
        self._blocks, self._most, self._free, self._drop = policy == "block", waiting, deque(slots), drop
        self._waiting: deque[tuple[Frame, Slot]] = deque()
        self._filling = 0
        self._changed = threading.Condition()
        self._closed = False

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Whether frames are refused."""
        return self._closed

    def slot(self) -> Slot:
        """An empty slot to fill; `put` or `give_back` must follow. LfgpuError if the inbox is or gets closed."""
        dropped: list[Frame] = []
        try:
            with self._changed:
                while True:
                    self._refuse_if_closed()
                    room = not self._blocks or len(self._waiting) + self._filling < self._most
                    if room and self._free:
                        break
                    if not self._blocks and self._waiting:
                        frame, slot = self._waiting.popleft()
                        dropped.append(frame)
                        self._free.append(slot)
                        continue
                    self._changed.wait()
                self._filling += 1
                return self._free.popleft()
        finally:
            for frame in dropped:
                self._drop(frame)

    def put(self, frame: Frame, slot: Slot) -> None:
        """A frame whose slot is filled waits from now on."""
        dropped: list[Frame] = []
        with self._changed:
            self._filling -= 1
            if self._closed:
                self._free.append(slot)
                dropped.append(frame)
            else:
                self._waiting.append((frame, slot))
                while len(self._waiting) > self._most:
                    old, old_slot = self._waiting.popleft()
                    dropped.append(old)
                    self._free.append(old_slot)
            self._changed.notify_all()
        for old in dropped:
            self._drop(old)

    def give_back(self, slot: Slot, *, filled: bool = False) -> None:
        """A slot is empty again: it could not be filled, or, if it was `filled`, what it held has been read."""
        with self._changed:
            self._filling -= not filled
            self._free.append(slot)
            self._changed.notify_all()

    def get(self) -> tuple[Frame, Slot] | None:
        """The frame that has waited longest, as soon as there is one; None when the inbox is closed and empty."""
        with self._changed:
            while not self._waiting:
                if self._closed and not self._filling:
                    return None
                self._changed.wait()
            taken = self._waiting.popleft()
            self._changed.notify_all()
            return taken

    def close(self, *, finish: bool) -> None:
        """Refuse frames from now on; those that wait are still given out if `finish`, else dropped."""
        dropped: list[Frame] = []
        with self._changed:
            self._closed = True
            while self._waiting and not finish:
                frame, slot = self._waiting.popleft()
                dropped.append(frame)
                self._free.append(slot)
            self._changed.notify_all()
        for frame in dropped:
            self._drop(frame)

    def _refuse_if_closed(self) -> None:
        if self._closed:
            raise LfgpuError("the stream is closed; make another one.")
