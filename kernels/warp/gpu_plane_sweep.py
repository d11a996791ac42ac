"""The plane sweep on a GPU: each warp has a strip of rows and 32 columns at one disparity, and all views of it."""

from typing import Any

import warp as wp

from .memory import pixel_type
from .native_code import kernel, names_of

BLOCK = 128
_STRIPS = {(False, False): 6, (False, True): 6, (True, True): 7, (True, False): 10}
"""Rows of a strip, by whether surfaces hide and gradients count: as measured, but for the first, which is a guess."""
WARP = 32  # threads


def threads_of(labels: int, height: int, width: int, *, seen: bool, gradients: bool) -> int:
    """Return the number of threads of a sweep."""
    strips, columns = -(-height // _STRIPS[seen, gradients]), -(-width // (WARP - 2 * gradients))
    return -(-labels * WARP // BLOCK) * BLOCK * strips * columns


def kept_type(channels: int, stored: Any) -> Any:
    """Return the type that a pixel of the views is kept as."""
    return pixel_type(4 if channels == 3 else 2, stored)


def pack_kernel(channels: int, stored: Any) -> Any:
    kept = kept_type(channels, stored)
    types = {"Stored": pixel_type(channels, stored), "Kept": kept}
    return kernel("plane_sweep.cuh", "pack", **types, CHANNELS=channels, PAD=kept._length_)


def mark_kernel(channels: int, stored: Any) -> Any:
    kept = kept_type(channels, stored)
    return kernel("plane_sweep.cuh", "mark", Kept=kept, PAD=kept._length_)


def sweep_kernel(
    channels: int, stored: Any, sets: int, seen: bool, gradients: bool, rooted: bool, set_penalty: float
) -> Any:
    """Return the kernel for so many view sets, or, if `seen`, for the views that see a pixel past a surface."""
    kept = kept_type(channels, stored)
    numbers = {
        "CHANNELS": channels,
        "SETS": sets,
        "COLUMNS": WARP - 2 * gradients,
        "STRIP": _STRIPS[seen, gradients],
        "RIM": int(gradients),
        "ROOTED": int(rooted),
        "PENALTY": set_penalty,
        "SEEN": seen,
        "BLOCK": BLOCK,
        "BYTES": {wp.uint8: 1, wp.uint16: 2}.get(stored, 0),
        "WORD": "unsigned" if channels == 3 else "unsigned short",
        **names_of(kept),
    }
    return kernel("plane_sweep.cuh", "sweep_strip", Kept=kept, Pixel=pixel_type(channels), **numbers)
