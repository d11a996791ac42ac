"""A lock that lets one thread at a time ask a device for work.

Warp has one current stream for each device, whatever the thread. It changes it for a moment in `wp.array` and in
`.numpy()`, and a capture concerns the whole process. So threads take turns.

A process that forks has its children begin while nobody asks: they find no lock taken. CUDA does not work in a child
of a process that has started it, so children refuse GPUs then.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import warp as wp

from lfgpu.errors import BackendError

from .threads import LOADING, once

_CAPTURING = threading.RLock()
_locks: dict[str, Any] = {}
_held_to_fork: list[Any] = []
_gpu_of_parent = False


def asking(device: str) -> Any:
    """Return one lock for each device: threads take turns to ask it, and devices do not wait for each other.

    BackendError for a GPU that a parent process has used before it forked.
    """
    if _gpu_of_parent and device != "cpu":
        raise BackendError(
            f"{device} cannot be used here: this process was forked from one that had started CUDA; start processes by "
            "multiprocessing.get_context('spawn'), or use device 'cpu'."
        )
    return _lock(device)


@contextmanager
def alone() -> Iterator[None]:
    """Held while work is captured: nobody else may ask any device meanwhile.

    RuntimeError for a thread that has `asking` of a device: two that wait for each other's device would wait for ever.
    """
    if not _owned(_CAPTURING) and any(_owned(lock) for lock in list(_locks.values())):
        raise RuntimeError("work is captured while its thread holds a device; capture it outside of `asking`.")
    with _CAPTURING, ExitStack() as held:
        for device in wp.get_devices():
            held.enter_context(_lock(device.alias))
        yield


@once
def _lock(device: str) -> Any:
    _locks[device] = lock = threading.RLock()
    return lock


def _owned(lock: Any) -> bool:
    return bool(lock._is_owned())  # as `threading.Condition` asks


def _before_fork() -> None:
    for lock in (_CAPTURING, *_locks.values(), LOADING):
        lock.acquire()
        _held_to_fork.append(lock)


def _after_fork() -> None:
    while _held_to_fork:
        _held_to_fork.pop().release()


def _in_child() -> None:
    global _gpu_of_parent
    _after_fork()
    _gpu_of_parent = _gpu_of_parent or any(device != "cpu" for device in started)


started: list[str] = []
"""The devices that Warp found when it was started in this process, or in the one that it was forked from."""

if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_in_child)
