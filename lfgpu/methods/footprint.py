"""The memory of an estimate, computed from sizes alone; `tests/test_tiles.py` compares it with measured memory."""

import re
from dataclasses import dataclass
from numbers import Real
from typing import Any

from lfgpu.errors import LightFieldError
from lfgpu.machine import device_memory, free_memory

PROCESS = 500 * 2**20  # bytes: Python, the libraries and the compiled kernels
GPU_CONTEXT = 640 * 2**20  # bytes of GPU memory that a process takes besides its arrays
SPARE = 2**29  # bytes of GPU memory that operations take at most to be faster
_SLACK = 1.1  # covers rounding by allocators, and small buffers
_MOST = 2.0**63  # bytes: no memory is so large
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


def parse_memory(value: str | float) -> int:
    """Convert a number or text such as "8GiB", "500 MB" or "2g" to bytes; raise LightFieldError for other text."""
    size: Any = value if isinstance(value, Real) and not isinstance(value, bool) else 0
    if isinstance(value, str) and (match := re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([kmgt]i?|)b?\s*", value.lower())):
        size = float(match[1]) * _UNITS[match[2]]
    if not 1 <= size < _MOST:
        raise LightFieldError(f"max_memory must be a size such as 8GiB or 500MB, not {value!r:.60}.")
    return int(size)


@dataclass(frozen=True)
class Footprint:
    """The memory of a `DepthPipeline`: bytes per pixel and per column of a view, plus a constant.

    What makes it faster takes `spare_per_pixel` bytes more, but at most `spare` bytes in all.
    """

    per_pixel: float
    besides: int
    spare_per_pixel: float = 0.0
    spare: int = 0
    per_column: float = 0.0

    def bytes(self, height: int, width: int) -> int:
        """Count the bytes for views of one size, including the process, or the context of the GPU."""
        spare = min(self.spare_per_pixel * height * width, self.spare)
        return self.besides + int(_SLACK * ((self.per_pixel * height + self.per_column) * width + spare))


class TooLittleMemoryError(LightFieldError):
    """A whole map takes more memory than there is; within `limit` bytes, as of `max_memory`, tiles may fit."""

    def __init__(self, needed: int, there: int, limit: int) -> None:
        self.limit = limit
        self.sizes = f"{needed / 2**30:.3g} GiB of memory, and there are {there / 2**30:.3g} GiB"
        super().__init__(
            f"a map in one piece takes about {self.sizes}: use fewer or smaller views or the preset fast, or make it "
            "in tiles with estimate_depth (lfgpu depth)."
        )


def check_memory(needed: Footprint, size: tuple[int, int], device: str, *, held: int) -> int:
    """Count the bytes of a plan for views of one size (height, width); TooLittleMemoryError if there are not so many.

    `held` are the bytes of views that are in memory already. A CPU has what is free: systems hand out more, and end the
    process when it uses that. A GPU has its whole memory.
    """
    whole, is_cpu = needed.bytes(*size), device == "cpu"
    there = free_memory() if is_cpu else device_memory(device)
    taken = needed.besides + held if is_cpu else 0  # by this process, and not free
    if there is not None and whole - taken > there:
        raise TooLittleMemoryError(whole, there, there + taken)
    return whole - needed.besides
