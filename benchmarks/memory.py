"""Memory of this process on the host, and of the GPUs."""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from pathlib import Path

from benchmarks.machine import nvidia_smi

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_INTERVAL = 0.1  # seconds between two looks at a GPU


def reset_host_peak() -> None:
    """Count the peak of the resident memory anew; where the system cannot, it stays that of the whole process."""
    with suppress(OSError):
        _CLEAR.write_text("5")


def host_peak() -> int | None:
    """Return the largest resident memory of this process in bytes; None where the system does not tell."""
    if (peak := _status("VmHWM")) is not None:
        return peak
    try:
        import resource
    except ImportError:  # Windows
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def allocated() -> int | None:
    """Return the memory that this process has allocated and uses, in bytes; None where the system does not tell.

    Pages of files are left out, such as code: the system takes them away and brings them back as it needs memory.
    """
    return _status("RssAnon")


def _status(name: str) -> int | None:
    with suppress(OSError):
        for line in _STATUS.read_text().splitlines():
            if line.startswith(f"{name}:"):
                return 1024 * int(line.split()[1])
    return None


def gpu_used() -> int | None:
    """Return the used memory of all GPUs together in bytes, whoever uses it; None where none can be asked."""
    lines = nvidia_smi("memory.used")
    try:
        return None if lines is None else sum(int(line) << 20 for line in lines)
    except ValueError:  # "[N/A]", as on parts of a shared GPU
        return None


class GpuPeak:
    """The peak of `gpu_used` while the block runs, looked at every 0.1 s; not to be timed, since looking takes time."""

    def __init__(self) -> None:
        self.bytes: int | None = None
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> GpuPeak:
        self._look()
        if self.bytes is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bytes is not None:
            self._done.set()
            self._thread.join()
            self._look()

    def _watch(self) -> None:
        while not self._done.wait(_INTERVAL):
            self._look()

    def _look(self) -> None:
        used = gpu_used()
        if used is not None:
            self.bytes = max(used, self.bytes or 0)
