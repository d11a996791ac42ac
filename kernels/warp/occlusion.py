"""The splat with occlusions, as `kernels/reference/occlusion.py` defines it.

A view is made in two passes over the reference pixels, first the z-buffer, then sums relative to it. A pixel of the
sums is its weighted colours, their weight and the coverage. The operation allocates 24 bytes for each pixel of three
channels of all its views, and gives them back.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from .memory import pixel_type
from .splat import as_offsets, foot, land
from .threads import in_slices, lanes, launch, load, once

_LEAST_WEIGHT = wp.constant(1e-20)
_NOWHERE = wp.constant(-3e38)  # the disparity of what is not there


@wp.struct
class Taps:
    """Landing place of a reference pixel, and its weights in the columns and rows there and next; 0 outside."""

    x: wp.int32
    y: wp.int32
    columns: wp.vec2f
    rows: wp.vec2f


@wp.func
def taps(x: int, y: int, height: int, width: int, disparity: float, offset: wp.vec2f, softness: float) -> Taps:
    to = land(x, y, disparity, offset)
    left = foot(1.0 - to.ax, softness)
    right = foot(to.ax, softness)
    upper = foot(1.0 - to.ay, softness)
    lower = foot(to.ay, softness)
    if to.x < 0 or to.x >= width:
        left = 0.0
    if to.x < -1 or to.x >= width - 1:
        right = 0.0
    if to.y < 0 or to.y >= height:
        upper = 0.0
    if to.y < -1 or to.y >= height - 1:
        lower = 0.0
    result = Taps()
    result.x = to.x
    result.y = to.y
    result.columns = wp.vec2f(left, right)
    result.rows = wp.vec2f(upper, lower)
    return result


@wp.kernel(enable_backward=False)
def _nearest_kernel(
    disparity: wp.array2d(dtype=float),
    offsets: wp.array(dtype=wp.vec2f),
    softness: float,
    lanes: int,
    nearest_out: wp.array3d(dtype=float),
):
    n, y, lane = wp.tid()
    for x in range(lane, disparity.shape[1], lanes):
        d = disparity[y, x]
        to = taps(x, y, disparity.shape[0], disparity.shape[1], d, offsets[n], softness)
        for k in range(4):
            if to.columns[k % 2] * to.rows[k / 2] > _LEAST_WEIGHT:
                wp.atomic_max(nearest_out, n, to.y + k / 2, to.x + k % 2, d)


@once
def _kernels(channels: int) -> SimpleNamespace:
    """Return the kernels for pixels of `channels` values."""
    pixel, sums = pixel_type(channels), pixel_type(channels + 2)
    module = f"lfgpu_occlusion_{channels}"

    @wp.kernel(module=module, enable_backward=False)
    def sums_kernel(
        image: wp.array2d(dtype=pixel),
        disparity: wp.array2d(dtype=float),
        offsets: wp.array(dtype=wp.vec2f),
        nearest: wp.array3d(dtype=float),
        softness: float,
        sharpness: float,
        lanes: int,
        sums_out: wp.array3d(dtype=sums),
    ):
        n, y, lane = wp.tid()
        for x in range(lane, image.shape[1], lanes):
            d = disparity[y, x]
            color = image[y, x]
            to = taps(x, y, image.shape[0], image.shape[1], d, offsets[n], softness)
            for k in range(4):
                given = to.columns[k % 2] * to.rows[k / 2]
                if given > _LEAST_WEIGHT:
                    tx = to.x + k % 2
                    ty = to.y + k / 2
                    weight = given * wp.exp(sharpness * (d - nearest[n, ty, tx]))
                    value = sums()
                    for c in range(wp.static(channels)):
                        value[c] = color[c] * weight
                    value[wp.static(channels)] = weight
                    value[wp.static(channels + 1)] = given
                    wp.atomic_add(sums_out, n, ty, tx, value)

    @wp.kernel(module=module, enable_backward=False)
    def means_kernel(
        sums_in: wp.array3d(dtype=sums),
        lanes: int,
        views_out: wp.array3d(dtype=pixel),
        coverage_out: wp.array3d(dtype=float),
    ):
        n, y, lane = wp.tid()
        for x in range(lane, sums_in.shape[2], lanes):
            total = sums_in[n, y, x]
            value = pixel()
            if total[wp.static(channels)] > 0.0:
                for c in range(wp.static(channels)):
                    value[c] = total[c] / total[wp.static(channels)]
            views_out[n, y, x] = value
            coverage_out[n, y, x] = total[wp.static(channels + 1)]

    return SimpleNamespace(sums=sums_kernel, means=means_kernel)


def splat_z_buffered(
    image: Any,
    disparity: Any,
    offsets: Any,
    *,
    softness: float,
    sharpness: float,
    views_out: Any,
    coverage_out: Any,
) -> None:
    channels, device, threads, pairs = image.dtype._length_, image.device, lanes(image), as_offsets(offsets)
    kernels = _kernels(channels)
    load(device, kernels.sums, _nearest_kernel)

    def some_views(_: int, first: int, last: int) -> None:
        views, coverage, some = views_out[first:last], coverage_out[first:last], pairs[first:last]
        nearest = wp.full(views.shape, _NOWHERE, dtype=float, device=device)
        sums = wp.zeros(views.shape, dtype=pixel_type(channels + 2), device=device)
        dim = (last - first, image.shape[0], threads)
        launch(_nearest_kernel, dim, [disparity, some, softness, threads], [nearest], device=device)
        inputs = [image, disparity, some, nearest, softness, sharpness, threads]
        launch(kernels.sums, dim, inputs, [sums], device=device)
        launch(kernels.means, dim, [sums, threads], [views, coverage], device=device)

    in_slices(device, len(views_out), some_views)
