"""Pictures looked up at other places by cubic convolution (Keys 1981), with other tones."""

from typing import Any

import taichi as ti

from .memory import DeviceArray, flat
from .runtime import once, run

_LEAST_GAIN = 0.05


@ti.func
def keys(t: ti.f32):
    """Weights of the four pixels around a place that is `t` of a pixel beyond the second of them."""
    s = 1.0 - t
    return ti.Vector([-0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t])


@once
def _kernel(channels: int, stored: Any) -> Any:
    images, whole, pixel = flat(stored, channels), stored not in (ti.f16, ti.f32), ti.types.vector(channels, ti.f32)

    @ti.kernel
    def resample_kernel(
        pictures: images,
        places: flat(),
        tones: flat(),
        white: float,
        height: int,
        width: int,
        size: int,
        views_out: images,
    ):
        """`height` and `width` are those of the pictures, `size` is the pixels of a view."""
        for p in range(views_out.shape[0]):
            n = p // size
            px, py, q = places[3 * p], places[3 * p + 1], places[3 * p + 2]
            value = pixel(0.0)
            if px >= -0.5 and px <= width - 0.5 and py >= -0.5 and py <= height - 0.5:
                px = ti.math.clamp(px, 0.0, width - 1.0)
                py = ti.math.clamp(py, 0.0, height - 1.0)
                column, row = ti.cast(px, ti.i32), ti.cast(py, ti.i32)
                across, down = keys(px - column), keys(py - row)
                total = pixel(0.0)
                for j in ti.static(range(4)):
                    first = (n * height + ti.math.clamp(row + j - 1, 0, height - 1)) * width
                    for i in ti.static(range(4)):
                        taken = pictures[first + ti.math.clamp(column + i - 1, 0, width - 1)]
                        total += down[j] * across[i] * ti.cast(taken, ti.f32)
                for c in ti.static(range(channels)):
                    tone = 3 * channels * n + c
                    gain = ti.max(tones[tone] + tones[tone + 2 * channels] * q, _LEAST_GAIN)
                    value[c] = ti.math.clamp((total[c] - tones[tone + channels]) / gain, 0.0, white)
                    if ti.static(whole):
                        value[c] = ti.round(value[c])
            views_out[p] = ti.cast(value, stored)

    return resample_kernel


def resample(
    pictures: DeviceArray, places: DeviceArray, tones: DeviceArray, *, white: float, views_out: DeviceArray
) -> None:
    _, height, width = pictures.shape
    kernel = _kernel(views_out.channels, views_out.scalar)
    size = views_out.shape[1] * views_out.shape[2]
    run(kernel, pictures, places, tones, white, height, width, size, views_out)
