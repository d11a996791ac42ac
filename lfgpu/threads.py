"""The largest number of CPU threads that lfgpu uses in a process."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from lfgpu.errors import LfgpuError

_Item = TypeVar("_Item")
_Done = TypeVar("_Done")

_VARIABLE = "LFGPU_THREADS"
_chosen: int | None = None
_here = threading.local()
_SHORT = 5e-4  # seconds after which Python lets another thread go on that leaves it soon, as decoders do


def set_threads(count: int | None) -> None:
    """Set the largest number of CPU threads. Results do not depend on it.

    Parameters
    ----------
    count
        An integer >= 1; None for one thread per core. The Taichi backend keeps the number with which it starts.

    Raises
    ------
    LfgpuError
        If `count` is not an integer >= 1.

    Examples
    --------
    >>> lfgpu.set_threads(2)
    >>> lfgpu.get_threads()
    2
    """
    global _chosen
    _chosen = None if count is None else _checked(count, "set_threads")


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Use at most `count` CPU threads while the block runs."""
    global _chosen
    before, _chosen = _chosen, count
    try:
        yield
    finally:
        _chosen = before


@contextmanager
def alone_here() -> Iterator[None]:
    """Work of the calling thread stays on it while the block runs: it has others beside it that must not wait."""
    _here.alone = True
    try:
        yield
    finally:
        _here.alone = False


@contextmanager
def on_signal(number: int, handler: Callable[[int, Any], object]) -> Iterator[None]:
    """Call `handler` on a signal while the block runs; only the main thread may change that, others do not."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def get_threads() -> int:
    """Return the largest number of CPU threads: from `set_threads`, else from $LFGPU_THREADS, else one per core.

    Examples
    --------
    >>> lfgpu.set_threads(1)
    >>> lfgpu.get_threads()
    1
    """
    if getattr(_here, "alone", False):
        return 1
    if _chosen is not None:
        return _chosen
    given = os.environ.get(_VARIABLE)
    return _checked(given, f"${_VARIABLE}") if given else _cores()


def in_threads(work: Callable[[_Item], _Done], items: Iterable[_Item], *, most: int | None = None) -> list[_Done]:
    """Call `work` on each item in several threads, at most `most`; returns the results in order.

    If several calls raise, the error of the first item is raised. Useful for work that releases the interpreter lock,
    as large NumPy operations and image decoders do.
    """
    with ThreadPoolExecutor(min(get_threads(), most or get_threads())) as pool:
        results = pool.map(work, items)
        try:
            do_waiting(among_threads=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return list(results)


@contextmanager
def meanwhile(work: Callable[[], None]) -> Iterator[None]:
    """Do `work` on this thread when the block first waits for other threads or a device, at its end at the latest.

    It is not done if the block raises before. What it raises itself ends the block.
    """
    _here.work = work
    try:
        yield
        do_waiting()
    finally:
        _here.work = None


def do_waiting(*, among_threads: bool = False) -> None:
    """Do the work of `meanwhile` now if that is still to do; call it once a device or other threads have work."""
    work, _here.work = getattr(_here, "work", None), None
    if work is None:
        return
    if not among_threads:
        work()
        return
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SHORT)
    try:
        work()
    finally:
        sys.setswitchinterval(interval)


def _cores() -> int:
    """Count the cores that this process may use; a container or a scheduler may limit it."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _checked(count: object, source: str) -> int:
    try:
        number = int(count)  # type: ignore[call-overload]
        if number == float(count) >= 1 and not isinstance(count, bool):  # type: ignore[arg-type]
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise LfgpuError(f"{source}: the number of threads must be an integer >= 1, found {count!r}.")
