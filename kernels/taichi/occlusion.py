"""The splat with occlusions, as `kernels/reference/occlusion.py` defines it.

A view is made in two passes over the reference pixels, first the z-buffer, then sums relative to it. A pixel of the
sums is its weighted colours, their weight and the coverage. On a CPU a view belongs to one thread, which needs no
atomics.
"""

from types import SimpleNamespace
from typing import Any

import taichi as ti

from .landing import foot, land, share_of_view, tasks_of_view
from .memory import DeviceArray, clear, flat, scratch
from .runtime import on_cpu, once, run

_LEAST_WEIGHT = 1e-20
_NOWHERE = -3e38  # the disparity of what is not there


@ti.func
def sides(a: float, first: int, size: int, softness: float):
    """Weights that a pixel `a` beyond `first` gives to the row or column `first` and the next; 0 outside the frame."""
    before = foot(1.0 - a, softness)
    after = foot(a, softness)
    if first < 0 or first >= size:
        before = 0.0
    if first < -1 or first >= size - 1:
        after = 0.0
    return ti.Vector([before, after])


@once
def _nearest_kernel(cpu: bool) -> Any:
    field = flat()

    @ti.kernel
    def nearest_kernel(
        disparity: field,
        offsets: field,
        softness: float,
        height: int,
        width: int,
        nearest_out: field,
    ):
        size = height * width
        for i in range(nearest_out.shape[0]):
            nearest_out[i] = _NOWHERE
        for task in range(offsets.shape[0] // 2 * tasks_of_view(size, cpu)):
            n, first, end = share_of_view(task, size, cpu)
            for p in range(first, end):
                d = disparity[p]
                to = land(p % width, p // width, d, offsets[2 * n], offsets[2 * n + 1])
                columns = sides(to.ax, to.x, width, softness)
                rows = sides(to.ay, to.y, height, softness)
                for k in ti.static(range(4)):
                    if columns[k % 2] * rows[k // 2] > _LEAST_WEIGHT:
                        i = n * size + (to.y + k // 2) * width + to.x + k % 2
                        if ti.static(cpu):
                            nearest_out[i] = ti.max(nearest_out[i], d)
                        else:
                            ti.atomic_max(nearest_out[i], d)

    return nearest_kernel


@once
def _splat_kernels(channels: int, cpu: bool) -> SimpleNamespace:
    """Return the kernels for pixels of `channels` values."""
    field, image_type, sums_type = flat(), flat(channels=channels), flat(channels=channels + 2)
    pixel, sums = ti.types.vector(channels, ti.f32), ti.types.vector(channels + 2, ti.f32)

    @ti.kernel
    def sums_kernel(
        image: image_type,
        disparity: field,
        offsets: field,
        nearest: field,
        softness: float,
        sharpness: float,
        height: int,
        width: int,
        sums_out: sums_type,
    ):
        """Add up what lands on each pixel; `sums_out` is 0 before."""
        size = height * width
        for task in range(offsets.shape[0] // 2 * tasks_of_view(size, cpu)):
            n, first, end = share_of_view(task, size, cpu)
            for p in range(first, end):
                d = disparity[p]
                color = image[p]
                to = land(p % width, p // width, d, offsets[2 * n], offsets[2 * n + 1])
                columns = sides(to.ax, to.x, width, softness)
                rows = sides(to.ay, to.y, height, softness)
                for k in ti.static(range(4)):
                    given = columns[k % 2] * rows[k // 2]
                    if given > _LEAST_WEIGHT:
                        i = n * size + (to.y + k // 2) * width + to.x + k % 2
                        weight = given * ti.exp(sharpness * (d - nearest[i]))
                        value = sums(0.0)
                        for c in ti.static(range(channels)):
                            value[c] = weight * color[c]
                        value[channels] = weight
                        value[channels + 1] = given
                        if ti.static(cpu):
                            sums_out[i] = sums_out[i] + value
                        else:
                            ti.atomic_add(sums_out[i], value)

    @ti.kernel
    def means_kernel(sums_in: sums_type, views_out: image_type, coverage_out: field):
        for i in range(coverage_out.shape[0]):
            total = sums_in[i]
            value = pixel(0.0)
            if total[channels] > 0.0:
                for c in ti.static(range(channels)):
                    value[c] = total[c] / total[channels]
            views_out[i] = value
            coverage_out[i] = total[channels + 1]

    return SimpleNamespace(sums=sums_kernel, means=means_kernel)


def splat_z_buffered(
    image: DeviceArray,
    disparity: DeviceArray,
    offsets: DeviceArray,
    *,
    softness: float,
    sharpness: float,
    views_out: DeviceArray,
    coverage_out: DeviceArray,
) -> None:
    assert image.channels is not None
    cpu, size = on_cpu(), image.shape
    kernels = _splat_kernels(image.channels, cpu)
    nearest = scratch(coverage_out, coverage_out.shape)
    sums = clear(scratch(coverage_out, coverage_out.shape, channels=image.channels + 2))
    run(_nearest_kernel(cpu), disparity, offsets, softness, *size, nearest)
    run(kernels.sums, image, disparity, offsets, nearest, softness, sharpness, *size, sums)
    run(kernels.means, sums, views_out, coverage_out)
