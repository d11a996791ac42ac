"""Queue of the frames of a stream, and its policies for frames that come too fast."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from lfgpu.errors import LfgpuError

POLICIES = {"latest": 1, "block": 2, "queue": 4}
"""The policies, and for each the default number of frames that may wait."""

Frame = TypeVar("Frame")
Slot = TypeVar("Slot")


class Inbox(Generic[Frame, Slot]):
    """Queue of frames in order, each with a slot that holds its data. It may be used from any thread.

    With the policy "block", adding a frame waits until there is space; else the oldest of more than `waiting` frames is
    dropped, of which `drop` is told while no lock is held. There are more `slots`: one is being filled and one read.
    """

    def __init__(self, policy: str, waiting: int, slots: list[Slot], drop: Callable[[Frame], None]) -> None:
        self._blocks, self._most, self._free, self._drop = policy == "block", waiting, deque(slots), drop
        self._waiting: deque[tuple[Frame, Slot]] = deque()
        self._filling = 0
        self._changed = threading.Condition()
        self._closed = False
        self.reason = ""
        """Reason of the end, if the owner did not close it."""

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """True if new frames are refused."""
        return self._closed

    def slot(self) -> Slot:
        """Get an empty slot to fill; `put` or `give_back` must follow. LfgpuError if the inbox is or becomes closed."""
        dropped: list[Frame] = []
        try:
            with self._changed:
                while True:
                    self.refuse_if_closed()
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
        """Add a frame whose slot is filled."""
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
        """Return a slot: its data has been read (`filled`), or it could not be filled."""
        with self._changed:
            self._filling -= not filled
            self._free.append(slot)
            self._changed.notify_all()

    def get(self) -> tuple[Frame, Slot] | None:
        """Wait for the oldest frame and take it; None when the inbox is closed and empty."""
        with self._changed:
            while not self._waiting:
                if self._closed and not self._filling:
                    return None
                self._changed.wait()
            taken = self._waiting.popleft()
            self._changed.notify_all()
            return taken

    def close(self, *, finish: bool, reason: str = "") -> None:
        """Refuse new frames; waiting frames can still be taken if `finish`, else they are dropped."""
        dropped: list[Frame] = []
        with self._changed:
            self.reason = self.reason or ("" if self._closed else reason)
            self._closed = True
            while self._waiting and not finish:
                frame, slot = self._waiting.popleft()
                dropped.append(frame)
                self._free.append(slot)
            self._changed.notify_all()
        for frame in dropped:
            self._drop(frame)

    def forget_slots(self) -> None:
        """Let go of the memory of all slots; nobody may ask for one any more."""
        self._free.clear()

    def refuse_if_closed(self) -> None:
        """Raise LfgpuError if new frames are refused."""
        if self._closed:
            why = f", because {self.reason}" if self.reason else ""
            raise LfgpuError(f"the stream is closed{why}; create a new one.")
