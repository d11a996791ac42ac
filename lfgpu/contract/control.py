"""Loops that the device decides about, work that it repeats or that becomes a file, and who may ask it for work."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from lfgpu.contract.arrays import Array, Scalar


class Control(Protocol):
    """Loops, captured work and locks of a device."""

    def is_deterministic(self, device: str) -> bool:
        """Tell whether an estimate on this device has the same bits each time, for any number of threads."""

    def kernel_cache(self) -> str | None:
        """Return the folder in which compiled kernels are kept from one process to the next; None if none are."""

    def asking(self, device: str) -> AbstractContextManager[object]:
        """Held while a device is asked for work, so that no capture of another thread records it.

        Many threads may ask at once. `capture` waits until none of them does, and they wait for it. The same thread may
        enter it again.
        """

    def prepare(self, work: Callable[[], None], device: str) -> None:
        """Compile and load the kernels of the operations that `work` asks for, several at the same time if it can.

        `work` is called once. Its operations may not be done: what they write is arbitrary.
        """

    def repeat(self, body: Callable[[], None], go_on: Scalar, most: int, *, at_once: int = 1) -> None:
        """Call `body` as long as `go_on` is positive, which is looked at before each call, and at most `most` times.

        With `at_once` > 1, a host that would wait for a GPU to look may look less often: about every `at_once`-th
        call, or first after as many as it took last time. Then `body` must change nothing once `go_on` is 0, but take 1
        from it. `body` asks for operations only, and one of them sets `go_on`. While work is captured (`capture`) the
        device itself repeats it.
        """

    def capture(self, work: Callable[[], None], device: str) -> Callable[[], None] | None:
        """Return a function that repeats `work` without the host; None where the device cannot be given work that way.

        `work` asks for operations only. It must have run once before, so that all kernels are loaded.
        """


class Recording(Protocol):
    """Recording of the work of a pipeline as a file."""

    def version(self) -> str:
        """Return the version of the backend's library. A file can be replayed by this version only."""

    def libraries(self) -> tuple[Path, Path]:
        """Return the folders of the library's shared objects and of its headers."""

    def save(
        self,
        work: Callable[[], None],
        path: Path,
        *,
        device: str,
        inputs: dict[str, Array],
        outputs: dict[str, Array],
    ) -> tuple[tuple[str, str, int, str], ...]:
        """Record `work` and write it to `path` (.wrp) and to a folder of compiled kernels beside it.

        `work` must have run once before. On a CPU it must ask for everything from the thread that calls this.

        Returns
        -------
        Of each kernel the file of its module, its name there, the bytes of its arguments, and its kind: "work"; or
        "begin" before each of several slices of launches that may run side by side, and "end" after the last one.
        """
