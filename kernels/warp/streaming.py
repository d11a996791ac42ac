"""What streams need beyond a single estimate (`lfgpu/contract/streaming.py`): the traffic, and the past of a map."""

from types import SimpleNamespace
from typing import Any

import warp as wp

from .memory import pixel_type
from .threads import launch_rows, once
from .transport import Transport as transport  # noqa: N813 - the contract's name for what makes one

__all__ = ["bias", "blend", "sameness", "transport"]

wp.set_module_options({"enable_backward": False})


@once
def _image_kernels(channels: int) -> SimpleNamespace:
    pixel = pixel_type(channels)
    module = f"lfgpu_live_{channels}"

    @wp.kernel(module=module, enable_backward=False)
    def sameness_kernel(
        image: wp.array2d(dtype=pixel),
        last: wp.array2d(dtype=pixel),
        tolerance: float,
        row: int,
        lanes: int,
        same_out: wp.array2d(dtype=float),
    ):
        i = wp.tid()
        y = row + i / lanes
        height = image.shape[0]
        width = image.shape[1]
        for x in range(i % lanes, width, lanes):
            total = float(0.0)
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    v = wp.clamp(y + dy, 0, height - 1)
                    u = wp.clamp(x + dx, 0, width - 1)
                    change = image[v, u] - last[v, u]
                    for c in range(wp.static(channels)):
                        total = total + wp.abs(change[c])
            ratio = total / (wp.static(9.0 * channels) * tolerance)
            square = ratio * ratio
            same_out[y, x] = 1.0 / (1.0 + square * square * square * square)

    return SimpleNamespace(sameness=sameness_kernel)


@wp.kernel
def _bias_kernel(
    past: wp.array2d(dtype=float),
    trust: wp.array2d(dtype=float),
    first: float,
    step: float,
    strength: float,
    reach: float,
    row: int,
    lanes: int,
    volume: wp.array3d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, volume.shape[2], lanes):
        weight = strength * trust[y, x] / reach
        place = (past[y, x] - first) / step
        for k in range(volume.shape[0]):
            volume[k, y, x] = volume[k, y, x] + weight * wp.min(wp.abs(float(k) - place), reach)


@wp.kernel
def _blend_kernel(
    past: wp.array2d(dtype=float),
    same: wp.array2d(dtype=float),
    persistence: float,
    support: float,
    row: int,
    lanes: int,
    frames: wp.array2d(dtype=float),
    disparity: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, disparity.shape[1], lanes):
        change = (past[y, x] - disparity[y, x]) / support
        square = change * change
        before = persistence * same[y, x] * frames[y, x] / (1.0 + square * square)
        disparity[y, x] = (disparity[y, x] + before * past[y, x]) / (1.0 + before)
        frames[y, x] = 1.0 + before


def sameness(image: Any, last: Any, *, tolerance: float, same_out: Any) -> None:
    """1 / (1 + (m / tolerance)^8) [y, x]: m is the mean change of intensity over 3 x 3 pixels and the channels."""
    launch_rows(_image_kernels(image.dtype._length_).sameness, [image, last, tolerance], same_out)


def bias(past: Any, trust: Any, volume: Any, *, first: float, step: float, strength: float, reach: float) -> None:
    """volume [l, y, x] += strength * trust * min(|first + l step - past| / step, reach) / reach."""
    launch_rows(_bias_kernel, [past, trust, first, step, strength, reach], volume)


def blend(past: Any, same: Any, frames: Any, disparity: Any, *, persistence: float, support: float) -> None:
    """The mean of the past map, which `frames` [y, x] went into, and the one of now; both become the new ones.

    With b = persistence * same * frames / (1 + ((past - disparity) / support)^4): disparity = (disparity + b past) /
    (1 + b), frames = 1 + b.
    """
    launch_rows(_blend_kernel, [past, same, persistence, support], frames, disparity)
