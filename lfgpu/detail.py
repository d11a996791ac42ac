"""Local contrast normalisation: what is left of an image without its local brightness and contrast."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lfgpu.lightfield import LightField
from lfgpu.threads import get_threads
from lfgpu.types import Float32Array

_TRUNCATE = 2.5  # Gaussians end after as many standard deviations


def normalized_views(lf: LightField, which: NDArray[np.intp], scale: float, floor: float) -> Float32Array:
    """Some views without their local mean and in units of their local contrast: float32 [n, y, x, c].

    The generative model adds up what lands on a pixel, so that its brightness follows the coverage, which on slanted
    surfaces is not 1: comparing raw intensities bends them. Detail has no brightness to follow, faint texture counts as
    much as strong, and differences in exposure between cameras cancel.

    Parameters
    ----------
    lf
        The light field. What its validity masks leave out does not leak into what is valid.
    which
        Indices of the views that are wanted.
    scale
        Standard deviation in pixels of the Gaussian whose local mean is taken off; contrast is measured over twice as
        much. 0 returns the intensities as they are.
    floor
        Contrast that is taken for noise, in intensity: less of it is not amplified to 1.
    """
    if scale == 0:
        return np.stack([lf.image(index) for index in which])
    out = np.empty((len(which), *lf.views.shape[1:]), np.float32)

    def normalize(place: int) -> None:
        index = int(which[place])
        mean = _local_mean(scale, None if lf.valid is None else lf.valid[index])
        wide = _local_mean(2 * scale, None if lf.valid is None else lf.valid[index])
        image = lf.image(index)
        detail = image - np.stack([mean(channel) for channel in np.moveaxis(image, 2, 0)], axis=2)
        contrast = np.sqrt(wide((detail**2).mean(2)) + np.float32(floor**2))
        out[place] = detail / contrast[..., None]

    with ThreadPoolExecutor(get_threads()) as pool:
        list(pool.map(normalize, range(len(which))))
    return out


def _local_mean(sigma: float, valid: NDArray[np.bool_] | None) -> Callable[[Float32Array], Float32Array]:
    """A Gaussian mean over valid pixels; 0 where there is none near."""

    def blur(values: Float32Array) -> Float32Array:
        return np.asarray(gaussian_filter(values, sigma, truncate=_TRUNCATE), np.float32)

    if valid is None or valid.all():
        return blur
    weight = blur(valid.astype(np.float32))
    return lambda values: np.where(weight > 1e-6, blur(values * valid) / np.maximum(weight, 1e-6), 0)
