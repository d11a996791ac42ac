"""About how strongly the data term curves along each pixel's disparity."""

from typing import Any

import warp as wp

from .memory import pixel_type
from .threads import launch_rows, once

wp.set_module_options({"enable_backward": False})


@once
def _kernel(channels: int) -> Any:
    pixel = pixel_type(channels)

    @wp.kernel(module=f"lfgpu_curvature_{channels}", enable_backward=False)
    def curvature_kernel(
        image: wp.array2d(dtype=pixel), factor: float, row: int, lanes: int, curvature_out: wp.array2d(dtype=float)
    ):
        i = wp.tid()
        y = row + i / lanes
        lane = i % lanes
        for x in range(lane, image.shape[1], lanes):
            curvature_out[y, x] = factor * wp.dot(image[y, x], image[y, x])

    return curvature_kernel


def curvature_factor(offsets: Any) -> float:
    """2 Σ |offset|² of offsets [n, 2]; waits for the device."""
    return 2.0 * float((offsets.numpy().astype("float64") ** 2).sum())


def curvature(image: Any, factor: float, curvature_out: Any) -> None:
    """factor * Σ_c image² of an image [y, x, c]."""
    launch_rows(_kernel(image.dtype._length_), [image, factor], curvature_out, light=True)
