"""Images between their pixels: cubic splines, which keep them sharper than bilinear interpolation."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from lfgpu.contract import Float32Array

_CUBIC = 3


def spline(image: Float32Array) -> Float32Array:
    """Coefficients [c, y, x] of the cubic splines through the pixels of an image [y, x, c], mirrored at its border."""
    planes = np.moveaxis(image, 2, 0)
    return np.stack([ndimage.spline_filter(plane, _CUBIC, output=np.float32, mode="mirror") for plane in planes])


def colours(coefficients: Float32Array, at: Float32Array) -> Float32Array:
    """Colours [y, x, c] of the splines at rows and columns [2, y, x], mirrored beyond the frame."""
    return np.stack([sampled(plane, at, _CUBIC) for plane in coefficients], axis=-1)


def sampled(values: Float32Array, at: Float32Array, order: int) -> Float32Array:
    """Values [y, x] at rows and columns [2, y, x]: the nearest ones (order 0), bilinear (1), or of coefficients (3)."""
    found: Float32Array = ndimage.map_coordinates(
        values, at, output=np.float32, order=order, mode="mirror", prefilter=False
    )
    return found


def valid_at(valid: np.ndarray, at: Float32Array) -> np.ndarray:
    """bool [y, x]: whether all pixels of a mask [y, x] around rows and columns [2, y, x] are True."""
    return np.asarray(sampled(valid.astype(np.float32), at, 1) > 1 - 1e-3)
