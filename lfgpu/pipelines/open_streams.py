"""Open streams, which are closed when the interpreter exits, because no device work may run then."""

from __future__ import annotations

import atexit
import threading
import weakref
from typing import Protocol


class _Closes(Protocol):
    def close(self, *, finish: bool = True) -> None: ...


OPEN: weakref.WeakSet[_Closes] = weakref.WeakSet()
"""Streams that are open."""


def _close_all() -> None:
    for stream in list(OPEN):
        stream.close(finish=False)


# Pools of threads end when the main thread does, before `atexit`; what is registered here ends before them.
getattr(threading, "_register_atexit", atexit.register)(_close_all)
