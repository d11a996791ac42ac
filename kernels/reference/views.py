"""Views as the method takes them: intensities of one, lines of several, local contrast normalisation; NumPy, float64.

The generative model adds up what lands on a pixel, so that its brightness follows the coverage, which on slanted
surfaces is not 1: comparing raw intensities bends them. Detail has no brightness to follow, faint texture counts as
much as strong, and differences in exposure between cameras cancel.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lfgpu.contract import Float64Array as Array, Normalization

TRUNCATE = 2.5  # Gaussians end after as many standard deviations
LEAST_SHARE = 1e-6  # of a Gaussian that must lie on valid pixels


def intensities(views: Array, index: int, valid: Array | None, *, scale: float, fill: float, image_out: Array) -> None:
    image_out[:] = scale * views[index]
    if valid is None:
        return
    known = np.pad(valid[index] != 0, 1)
    shown = np.pad(image_out, ((1, 1), (1, 1), (0, 0)))
    total, count = np.zeros_like(image_out), np.zeros((*image_out.shape[:2], 1))
    for before, after in ((np.s_[1:-1, :-2], np.s_[1:-1, 2:]), (np.s_[:-2, 1:-1], np.s_[2:, 1:-1])):
        both = (known[before] & known[after])[..., None]
        total += np.where(both, shown[before] + shown[after], 0)
        count += 2 * both
    means = np.divide(total, count, out=np.full_like(total, fill), where=count != 0)
    image_out[:] = np.where(known[1:-1, 1:-1, None], image_out, means)


def line_of_views(
    views: Array, line: Sequence[int], *, vertical: bool, epis_out: Array, corner: tuple[int, int] = (0, 0)
) -> None:
    for epi, index in zip(epis_out, line, strict=True):
        view = views[index, corner[0] :, corner[1] :]
        epi[:] = (view.swapaxes(0, 1) if vertical else view)[: epi.shape[0], : epi.shape[1]]


def blur(values: Array, sigma: float) -> Array:
    """Compute the Gaussian mean of [y, x], mirrored at the borders with the border pixels repeated."""
    return np.asarray(gaussian_filter(values, sigma, mode="reflect", truncate=TRUNCATE))


def local_mean(values: Array, sigma: float, counts: NDArray[np.bool_]) -> Array:
    """Compute the Gaussian mean of [y, x] over the pixels that count, 0 where none is near."""
    share = blur(counts.astype(np.float64), sigma)
    total = blur(np.where(counts, values, 0), sigma)
    return np.where(share > LEAST_SHARE, total / np.maximum(share, LEAST_SHARE), 0)


def normalized(image: Array, counts: NDArray[np.bool_], sigma: float, floor: float) -> Array:
    """Compute the detail of one image [y, x, c]."""
    mean = np.stack([local_mean(channel, sigma, counts) for channel in np.moveaxis(image, 2, 0)], axis=2)
    detail = image - mean
    contrast = local_mean((detail**2).mean(2), 2 * sigma, counts)
    return detail / np.sqrt(contrast + floor**2)[..., None]


def normalization(shape: Sequence[int], device: str, *, scale: float, sigma: float, floor: float) -> Normalization:
    def evaluate(views: Array, valid: Array | None, detail_out: Array) -> None:
        counts = np.ones(shape[:3], np.bool_) if valid is None else valid != 0
        for view, counting, detail in zip(views, counts, detail_out, strict=True):
            detail[:] = scale * view if sigma == 0 else normalized(scale * view, counting, sigma, floor)

    return evaluate
