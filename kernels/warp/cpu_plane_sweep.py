"""The plane sweep on a CPU; `kernels/reference/plane_sweep.py` says what it is, `plane_sweep.py` plans it."""

from types import SimpleNamespace
from typing import Any

import warp as wp

from .memory import pixel_type
from .native_code import kernel
from .threads import once

_STRIP = 16  # rows of sums that stay in the cache
LANES = 128  # of a chunk: its columns, and one at either side for differences


def kept_type(stored: Any) -> Any:
    """Return the type that views are kept as: as they are stored, if a CPU can make vectors of that."""
    return wp.float32 if stored is wp.float16 else stored


@once
def loading_kernels(channels: int, stored: Any) -> SimpleNamespace:
    """Return the kernels that keep `views` of scalar type `stored`, with a margin, and the reference `image`."""
    pixel, stored_pixel, kept = pixel_type(channels), pixel_type(channels, stored), kept_type(stored)
    module = f"lfgpu_plane_sweep_load_{channels}_{stored.__name__}"

    @wp.kernel(module=module, enable_backward=False)
    def image_kernel(image: wp.array2d(dtype=pixel), scale: float, kept_out: wp.array3d(dtype=float)):
        """Keep the reference in stored values, a column farther right: before it and behind it is room for a chunk."""
        y, x = wp.tid()
        for c in range(wp.static(channels)):
            kept_out[c, y, x + 1] = image[y, x][c] / scale

    types = {"Stored": stored_pixel, "Kept": kept}
    keep = kernel("plane_sweep.h", "keep_views", module=module, **types, CHANNELS=channels)
    return SimpleNamespace(views=keep, image=image_kernel)


def sweep_kernel(channels: int, kept: Any, gradients: bool, rooted: bool, penalty: float) -> Any:
    """Return the kernel for views of scalar type `kept`.

    Without `gradients` their weight must be 0; `penalty` is of all view sets but the first.
    """
    numbers = {"CHANNELS": channels, "STRIP": _STRIP, "LANES": LANES, "PENALTY": penalty}
    numbers |= {"GRADIENTS": int(gradients), "ROOTED": int(rooted)}
    return kernel("plane_sweep.h", "sweep_rows", Kept=kept, **numbers)


def room_of(channels: int, groups: int) -> int:
    """Floats that a thread needs for so many channels and groups."""
    return 3 * channels * (LANES + 2) + channels * LANES + (2 * groups + 1) * _STRIP * LANES


def margins(width: int, farthest: int) -> tuple[int, int]:
    """Columns that kept views are longer at their left, and in all, if shifts are at most `farthest` pixels."""
    margin = 2 + min(farthest, width)
    return margin, 2 * margin + max(0, LANES - 2 - width)
