"""Queue of the frames of a stream, and its policies for frames that come too fast."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from lfgpu.data.light_field_checks import check_whole
from lfgpu.errors import LfgpuError, LightFieldError

POLICIES = {"latest": 1, "block": 2, "queue": 4}
"""The policies, and for each the default number of frames that may wait."""

_MOST_WAITING = 1000

Frame = TypeVar("Frame")
Slot = TypeVar("Slot")


def most_waiting(policy: str, waiting: int | None) -> int:
    """Find the number of frames that may wait; LightFieldError if the policy is unknown, or forbids the number."""
    if policy not in POLICIES:
        raise LightFieldError(f"policy must be one of {', '.join(POLICIES)}, not {policy!r}.")
    if waiting is None:
        return POLICIES[policy]
    check_whole("waiting", waiting, 1, _MOST_WAITING)
    if policy == "latest" and waiting != 1:
        raise LightFieldError(f"waiting must be 1 for the policy latest, not {waiting!r}.")
    return int(waiting)


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
        self.closed = False
        """True if new frames are refused."""
        self.reason = ""
        """Reason of the end, if the owner did not close it."""

    def __len__(self) -> int:
        return len(self._waiting)

    def slot(self) -> Slot:
        """Get an empty slot to fill; `put` or `give_back` must follow. LfgpuError if the inbox is or becomes closed."""
        while True:
            with self._changed:
                self.refuse_if_closed()
                room = not self._blocks or len(self._waiting) + self._filling < self._most
                if room and self._free:
                    self._filling += 1
                    return self._free.popleft()
                if self._blocks or not self._waiting:
                    self._changed.wait()
                    continue
                old = self._take_out()
            self._drop(old)

    def put(self, frame: Frame, slot: Slot) -> None:
        """Add a frame whose slot is filled."""
        with self._changed:
            self._filling -= 1
            self._waiting.append((frame, slot))
            many = len(self._waiting) - self._most
            dropped = [self._waiting.pop()] if self.closed else [self._waiting.popleft() for _ in range(many)]
            self._free.extend(slot for _, slot in dropped)
            self._changed.notify_all()
        for old, _ in dropped:
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
                if self.closed and not self._filling:
                    return None
                self._changed.wait()
            taken = self._waiting.popleft()
            self._changed.notify_all()
            return taken

    def close(self, *, finish: bool, reason: str = "") -> None:
        """Refuse new frames; waiting frames can still be taken if `finish`, else they are dropped."""
        with self._changed:
            self.reason = self.reason or ("" if self.closed else reason)
            self.closed = True
            dropped = [] if finish else [self._take_out() for _ in range(len(self._waiting))]
            self._changed.notify_all()
        for old in dropped:
            self._drop(old)

    def forget_slots(self) -> None:
        """Let go of the memory of all slots; nobody may ask for one any more."""
        self._free.clear()

    def refuse_if_closed(self) -> None:
        """Raise LfgpuError if new frames are refused."""
        if self.closed:
            why = f", because {self.reason}" if self.reason else ""
            raise LfgpuError(f"the stream is closed{why}; create a new one.")

    def _take_out(self) -> Frame:
        """Take out the oldest frame, which nobody will read; the caller holds the lock, and drops the frame later."""
        frame, slot = self._waiting.popleft()
        self._free.append(slot)
        return frame
