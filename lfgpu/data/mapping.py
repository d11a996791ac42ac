"""Arrays that are mapped from files: only what is looked at takes memory, until it is forgotten."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Sequence
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.threads import in_threads

_AT_ONCE = 2**26  # bytes of views that are forgotten together,
_LEAST = 4  # or as many views, so that threads have something to do
_WORTHWHILE = 2**22  # bytes: less is looked at before threads have begun


def mapped(
    file: IO[bytes], shape: Sequence[int], dtype: Any, *, offset: int = 0, fortran: bool = False
) -> NDArray[Any]:
    """An array that lies in an open file from `offset` on, read-only."""
    order: Any = "F" if fortran else "C"
    return np.asarray(np.memmap(file, dtype, "r", offset=offset, shape=tuple(shape), order=order))


def is_mapped(array: NDArray[Any]) -> bool:
    """Whether an array lies in a file, which it cannot change."""
    return _mapping(array) is not None


def forget(array: NDArray[Any]) -> None:
    """Give back the memory that a mapped array took for what was read of it; nothing happens to other arrays."""
    mapping = _mapping(array)
    if mapping is not None and hasattr(mapping, "madvise"):  # not on Windows
        mapping.madvise(mmap.MADV_DONTNEED)


def each_view(views: NDArray[Any], chosen: Sequence[int], work: Callable[[int, NDArray[Any]], None]) -> None:
    """Call work(k, views[chosen[k]]) for all k, on all threads, and forget on the way what was read of a file."""
    at_once = len(chosen)
    if is_mapped(views):
        # Where they are windows of views in the file, the system maps what lies between their rows as well.
        at_once = max(_LEAST, _AT_ONCE // max(views[0].nbytes, abs(views.strides[0])))
    elif views.nbytes < _WORTHWHILE:
        for k, index in enumerate(chosen):
            work(k, views[index])
        return
    for first in range(0, len(chosen), max(at_once, 1)):
        in_threads(lambda k: work(k, views[chosen[k]]), range(first, min(first + at_once, len(chosen))))
        forget(views)


def _mapping(array: Any) -> mmap.mmap | None:
    """Of a mapped array what it is mapped by, if nothing of it can have been changed: that would be forgotten, too."""
    while isinstance(array, np.ndarray):
        if isinstance(array, np.memmap) and array.mode != "r":
            return None
        array = array.base
    return array if isinstance(array, mmap.mmap) else None
