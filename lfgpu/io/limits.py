"""Sizes that a file claims are judged before memory is taken for them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.errors import LightFieldError

_BEST_RATIO = 2000  # deflate reaches 1032; no picture of a scene comes near what the best packers do with black
_ALWAYS_FINE = 1 << 24  # bytes: so much may be claimed by the smallest file


def check_claim(
    path: Path,
    shape: Sequence[int],
    dtype: Any,
    *,
    in_memory: bool = True,
) -> None:
    """Raise LightFieldError if an array that a file claims to hold can neither be in the file nor in the memory.

    Parameters
    ----------
    path
        The file, of which only the size is looked at.
    shape, dtype
        What its header says of the array.
    in_memory
        Whether memory will be taken for it.
    """
    if any(side < 0 for side in shape):
        raise LightFieldError(f"{path} is damaged: it claims an array of shape {tuple(shape)}.")
    claimed = math.prod(int(side) for side in shape) * np.dtype(dtype).itemsize
    stored = path.stat().st_size
    if claimed > max(_ALWAYS_FINE, stored * _BEST_RATIO):
        raise LightFieldError(
            f"{path} is damaged: it claims {claimed} bytes of pixels, which a file of {stored} bytes cannot hold."
        )
    if in_memory:
        check_memory(path, claimed, advice="read fewer or smaller views")


def check_memory(path: Path, needed: int, *, advice: str) -> None:
    """Raise LightFieldError if so many bytes are more than the machine has."""
    memory = physical_memory()
    if memory and needed > memory:
        raise LightFieldError(
            f"{path} does not fit into memory: its views are {needed / 2**30:.1f} GiB, "
            f"this machine has {memory / 2**30:.1f} GiB; {advice}."
        )


def physical_memory() -> int:
    """Return the memory of the machine in bytes; 0 where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # Windows has no sysconf
        return 0
