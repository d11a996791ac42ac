"""Snapshots that one thread shows when others ask for them."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

Shown = TypeVar("Shown")


class Snapshots(Generic[Shown]):
    """Exchange of snapshots: threads ask and wait; the owner puts the next one if it is `wanted`."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._asking, self._closed = 0, False
        self._count = 0
        self._latest: Shown | None = None

    @property
    def wanted(self) -> bool:
        """True if a thread waits."""
        return self._asking > 0

    def get(self, timeout: float | None) -> Shown | None:
        """Wait for the next snapshot, at most `timeout` seconds; None if there was none, or after `close`."""
        with self._changed:
            before = self._count
            self._asking += 1
            try:
                self._changed.wait_for(lambda: self._closed or self._count > before, timeout)
                return self._latest if self._count > before else None
            finally:
                self._asking -= 1
                if not self._asking:
                    self._latest = None

    def put(self, shown: Shown) -> None:
        """Give a snapshot to all threads that wait."""
        with self._changed:
            self._latest = shown
            self._count += 1
            self._changed.notify_all()

    def close(self) -> None:
        """End the exchange: no snapshot will come any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
