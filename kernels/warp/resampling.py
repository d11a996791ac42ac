"""Pictures looked up at other places by cubic convolution (Keys 1981), with other tones."""

from typing import Any

import warp as wp

from .memory import pixel_type
from .pixels import Volume, pixelwise
from .threads import once

wp.set_module_options({"enable_backward": False})

_LEAST_GAIN = 0.05


@wp.func
def _keys(t: float) -> wp.vec4:
    """Weights of the four pixels around a place that is `t` of a pixel beyond the second of them."""
    s = 1.0 - t
    return wp.vec4(-0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t)


@once
def _resample(channels: int, stored: Any) -> Any:
    pixel, stored_pixel = pixel_type(channels), pixel_type(channels, stored)
    whole = stored not in (wp.float16, wp.float32)

    @pixelwise(f"lfgpu_resampling_{channels}_{stored.__name__}")
    def resample(
        n: int,
        y: int,
        x: int,
        pictures: wp.array3d(dtype=stored_pixel),
        places: wp.array4d(dtype=float),
        tones: Volume,
        white: float,
        views_out: wp.array3d(dtype=stored_pixel),
    ):
        height = pictures.shape[1]
        width = pictures.shape[2]
        right = float(width - 1)
        bottom = float(height - 1)
        out = stored_pixel()
        px = places[n, y, x, 0]
        py = places[n, y, x, 1]
        if px >= -0.5 and px <= right + 0.5 and py >= -0.5 and py <= bottom + 0.5:
            px = wp.clamp(px, 0.0, right)
            py = wp.clamp(py, 0.0, bottom)
            column = int(px)
            row = int(py)
            across = _keys(px - float(column))
            down = _keys(py - float(row))
            total = pixel()
            for j in range(wp.static(4)):
                along = pixel()
                for k in range(wp.static(4)):
                    taken = pictures[n, wp.clamp(row + j - 1, 0, height - 1), wp.clamp(column + k - 1, 0, width - 1)]
                    for c in range(wp.static(channels)):
                        along[c] = along[c] + across[k] * float(taken[c])
                total = total + down[j] * along
            q = places[n, y, x, 2]
            for c in range(wp.static(channels)):
                gain = wp.max(tones[n, 0, c] + tones[n, 2, c] * q, wp.static(_LEAST_GAIN))
                value = wp.clamp((total[c] - tones[n, 1, c]) / gain, 0.0, white)
                if wp.static(whole):
                    out[c] = stored(wp.rint(value))
                else:
                    out[c] = stored(value)
        views_out[n, y, x] = out

    return resample


def resample(pictures: Any, *arguments: Any, **named: Any) -> None:
    _resample(pictures.dtype._length_, pictures.dtype._wp_scalar_type_)(pictures, *arguments, **named)
