"""Views that stay on disk, and their unpacking into temporary files."""

import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.mapping import mapped
from lfgpu.errors import LightFieldError
from lfgpu.io.damage import check_memory
from lfgpu.io.reporting import within

_WANTED: ContextVar[bool] = ContextVar("views stay on disk", default=False)


def on_disk(wanted: bool) -> AbstractContextManager[object]:
    """Have readers in this block leave views on disk, as far as they can, if that is wanted."""
    return within(_WANTED, wanted)


def wanted_on_disk() -> bool:
    """Tell whether a reader is asked to leave views on disk."""
    return _WANTED.get()


class Collected:
    """Arrays of one shape and type as one array [n, ...] in memory or in a temporary file, filled by several threads.

    The file lies in the system's folder for such (`TMPDIR`), has no name there and is gone with the array.
    LightFieldError that names `source` if memory or disk do not suffice; MemoryError is left to the caller.
    """

    def __init__(self, source: Path, count: int, like: NDArray[Any]) -> None:
        self._source, self.shape, self._dtype = source, (count, *like.shape), like.dtype
        self._file: IO[bytes] | None = None
        self._writing, needed = threading.Lock(), count * like.nbytes
        if wanted_on_disk():
            folder = tempfile.gettempdir()
            if needed > (free := shutil.disk_usage(folder).free):
                raise LightFieldError(
                    f"{source}: its views are {needed / 2**30:.1f} GiB unpacked, {folder} has room for "
                    f"{free / 2**30:.1f} GiB; set TMPDIR to a folder with more."
                )
            self._file = tempfile.TemporaryFile(prefix="lfgpu-")  # noqa: SIM115 - the array lives as long as it
        else:
            check_memory(source, needed, advice="read fewer views, or leave them on disk (lazy=True, --max-memory)")
            self._array = np.empty(self.shape, self._dtype)

    def put(self, index: int, values: NDArray[Any]) -> None:
        """Take the array that comes at `index`."""
        if self._file is None:
            self._array[index] = values
            return
        with self._writing, self._said():
            self._file.seek(index * values.nbytes)
            self._file.write(np.ascontiguousarray(values).data)  # a full disk is an error here; mapped, a crash

    def array(self) -> NDArray[Any]:
        """Return all of them."""
        if self._file is None:
            return self._array
        with self._said():
            self._file.flush()
        return mapped(self._file, self.shape, self._dtype)

    @contextmanager
    def _said(self) -> Iterator[None]:
        """Turn errors of the disk into a sentence."""
        try:
            yield
        except OSError as error:
            raise LightFieldError(
                f"{self._source}: the views cannot be unpacked into {tempfile.gettempdir()}: {error.strerror}; set "
                "TMPDIR to a folder with more room."
            ) from error
