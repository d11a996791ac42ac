"""An optional capability of a backend: work as a file that a program without Python replays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from lfgpu.contract.arrays import Array


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
