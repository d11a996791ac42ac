"""How many threads of the CPU lfgpu may use: one number for the process."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from lfgpu.errors import LfgpuError

_Item = TypeVar("_Item")
_Done = TypeVar("_Done")

_VARIABLE = "LFGPU_THREADS"
_chosen: int | None = None


def set_threads(count: int | None) -> None:
    """Use at most `count` threads of the CPU (1 or more) from now on; None for as many as the process has cores.

    Results do not depend on it. The Taichi backend takes the number when it starts and keeps it. LfgpuError if `count`
    is not a whole number from 1 on.
    """
    global _chosen
    _chosen = None if count is None else _checked(count, "set_threads")


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Use at most `count` threads of the CPU while the block runs."""
    global _chosen
    before, _chosen = _chosen, count
    try:
        yield
    finally:
        _chosen = before


def get_threads() -> int:
    """How many threads of the CPU are used: what `set_threads` said, else $LFGPU_THREADS, else one for each core."""
    if _chosen is not None:
        return _chosen
    given = os.environ.get(_VARIABLE)
    return _checked(given, f"${_VARIABLE}") if given else _cores()


def in_threads(work: Callable[[_Item], _Done], items: Iterable[_Item], *, most: int | None = None) -> list[_Done]:
    """What `work` returns for each item, called on all threads, or at most so many; its first error ends it.

    The first in the order of the items. For work that leaves the interpreter's lock, as large operations of NumPy and
    decoders of images do.
    """
    with ThreadPoolExecutor(min(get_threads(), most or get_threads())) as pool:
        return list(pool.map(work, items))


def _cores() -> int:
    """The cores that this process may run on, which a container or a scheduler may have limited."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _checked(count: object, source: str) -> int:
    try:
        number = int(count)  # type: ignore[call-overload]
        if number == float(count) >= 1 and not isinstance(count, bool):  # type: ignore[arg-type]
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise LfgpuError(f"{source}: the number of threads must be a whole number from 1 on, found {count!r}.")
