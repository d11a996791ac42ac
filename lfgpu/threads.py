"""How many threads of the CPU lfgpu may use: one number for the process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from lfgpu.errors import LfgpuError

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
