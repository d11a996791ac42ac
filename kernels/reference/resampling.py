"""Pictures looked up at other places by cubic convolution (Keys 1981), with other tones; NumPy, float64."""

import numpy as np

from lfgpu.contract import Float64Array as Array

LEAST_GAIN = 0.05


def keys(t: Array) -> list[Array]:
    """Weights of the four pixels around a place that is `t` of a pixel beyond the second of them."""
    s = 1 - t
    return [-t * s * s / 2, 1 + t * t * (1.5 * t - 2.5), 1 + s * s * (1.5 * s - 2.5), -s * t * t / 2]


def resample(pictures: Array, places: Array, tones: Array, *, white: float, views_out: Array) -> None:
    height, width = pictures.shape[1:3]
    for picture, place, (gain, offset, falloff), view in zip(pictures, places, tones, views_out, strict=True):
        x, y, q = np.moveaxis(place, -1, 0)
        inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
        x, y = (np.where(inside, at, 0).clip(0, size - 1) for at, size in ((x, width), (y, height)))
        columns, rows = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
        total = np.zeros_like(view, np.float64)
        for j, down in enumerate(keys(y - rows)):
            for i, across in enumerate(keys(x - columns)):
                taken = picture[(rows + j - 1).clip(0, height - 1), (columns + i - 1).clip(0, width - 1)]
                total += (down * across)[..., None] * taken
        total = ((total - offset) / np.maximum(gain + falloff * q[..., None], LEAST_GAIN)).clip(0, white)
        view[:] = np.where(inside[..., None], total, 0)
