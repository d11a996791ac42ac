"""Memory-mapped arrays: only the parts that are read take memory, until it is released."""

import mmap
import os
from collections.abc import Callable, Sequence
from typing import IO, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.threads import in_threads

_AT_ONCE = 2**26  # bytes of views after which memory is released,
_LEAST = 4  # or this many views, so that all threads have work
_WORTHWHILE = 2**22  # bytes: below this size, threads are not worth their start


def mapped(
    file: IO[bytes], shape: Sequence[int], dtype: Any, *, offset: int = 0, fortran: bool = False
) -> NDArray[Any]:
    """Map a read-only array from an open file, beginning at byte `offset`."""
    order: Any = "F" if fortran else "C"
    array = np.asarray(np.memmap(file, dtype, "r", offset=offset, shape=tuple(shape), order=order))
    mapping = _mapping(array)
    if mapping is not None and isinstance(file.name, str | os.PathLike):
        found = os.fstat(file.fileno())
        _FILES[mapping] = os.fspath(file.name), (found.st_ino, found.st_mtime_ns, found.st_size)
    return array


_FILES: WeakKeyDictionary[mmap.mmap, tuple[str, tuple[int, int, int]]] = WeakKeyDictionary()
"""By mapping the name of its file, and what tells that it was written anew."""


def check_unchanged(array: NDArray[Any]) -> None:
    """Raise LightFieldError if the file of a mapped array was cut short or written anew: reading on would end the
    process, or mix two contents. A file that was replaced is another one, and leaves the array as it is."""
    mapping = _mapping(array)
    if mapping is None:
        return
    name, before = _FILES.get(mapping, ("the file of the views", None))
    changed = mapping.size() < len(mapping)
    if before is not None and not changed:
        try:
            found = os.stat(name)  # noqa: PTH116 - the name may be a text
        except OSError:
            return
        changed = found.st_ino == before[0] and (found.st_mtime_ns, found.st_size) != before[1:]
    if changed:
        raise LightFieldError(f"{name} was written anew while it was in use; read it again.")


def is_mapped(array: NDArray[Any]) -> bool:
    """Tell whether an array is mapped read-only from a file."""
    return _mapping(array) is not None


def forget(array: NDArray[Any]) -> None:
    """Release the memory of the parts of a mapped array that were read; other arrays are left alone."""
    mapping = _mapping(array)
    if mapping is not None and hasattr(mapping, "madvise"):  # not on Windows
        mapping.madvise(mmap.MADV_DONTNEED)


def each_view(views: NDArray[Any], chosen: Sequence[int], work: Callable[[int, NDArray[Any]], None]) -> None:
    """Call work(k, views[chosen[k]]) for all k in several threads; releases the memory of mapped views on the way."""
    at_once = len(chosen)
    if is_mapped(views):
        # For windows of views, the system also loads the parts of the file between their rows.
        at_once = max(_LEAST, _AT_ONCE // max(views[0].nbytes, abs(views.strides[0])))
    elif views.nbytes < _WORTHWHILE:
        for k, index in enumerate(chosen):
            work(k, views[index])
        return
    for first in range(0, len(chosen), max(at_once, 1)):
        check_unchanged(views)
        in_threads(lambda k: work(k, views[chosen[k]]), range(first, min(first + at_once, len(chosen))))
        forget(views)


def _mapping(array: Any) -> mmap.mmap | None:
    """Return the mapping of a read-only mapped array, else None: a writable one could lose changes when released."""
    while isinstance(array, np.ndarray):
        if isinstance(array, np.memmap) and array.mode != "r":
            return None
        array = array.base
    return array if isinstance(array, mmap.mmap) else None
