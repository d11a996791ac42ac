"""All cores of a CPU: Warp runs a launch on one thread, so that work is cut into slices, each launched from its own.

How the work is cut does not depend on the number of threads, so neither do the results.
"""

import os
import threading
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from typing import Any, TypeVar

import warp as wp

_SLICES = 16
_LOCK = threading.RLock()

Result = TypeVar("Result")


def once(function: Callable[..., Result]) -> Callable[..., Result]:
    """Call a function once for each set of arguments and keep what it returned; other threads wait meanwhile."""
    kept = cache(function)

    @wraps(function)
    def call(*arguments: Hashable) -> Result:
        with _LOCK:
            return kept(*arguments)

    return call


def in_slices(device: Any, count: int, work: Callable[[int, int, int], None]) -> None:
    """Call work(slice, first, last) for slices of range(count): one for all on a GPU, several at a time on a CPU."""
    cuts = slices(device, count)
    if len(cuts) == 1:
        work(0, 0, count)
        return
    for done in [_pool().submit(work, k, first, last) for k, (first, last) in enumerate(cuts)]:
        done.result()


def slices(device: Any, count: int) -> list[tuple[int, int]]:
    """The (first, last) of each slice that `in_slices` makes."""
    parts = min(_SLICES, count) if device.is_cpu else 1
    return [(count * k // parts, count * (k + 1) // parts) for k in range(parts)]


def load(device: Any, *kernels: Any) -> None:
    """Compile and load what threads are about to launch; they must not do it at the same time."""
    with _LOCK:
        for module in {kernel.module for kernel in kernels}:
            wp.load_module(module, device=device)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="lfgpu")


if hasattr(os, "register_at_fork"):  # the threads of a pool do not live on in a forked process
    os.register_at_fork(after_in_child=_pool.cache_clear)
