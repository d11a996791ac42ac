"""Views for comparisons: means of pixels that look alike, and reduced views; NumPy, float64.

Noise hides faint texture from differences of single pixels, as their size is taken before they are averaged. What looks
alike in one view lies on one surface, so that its mean shows that surface with less noise. Which pixels look alike is
decided on means over 3 x 3 pixels, in which the noise is less, too. What is not valid has no part in any mean.
"""

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import REDUCTION, SMOOTHING_REACH, WHITE, Float64Array as Array

_SPREAD = 8.0  # pixels²: twice the variance of the Gaussian over places


def _stored(intensities: Array) -> Array:
    return np.floor(WHITE * np.clip(intensities, 0, 1) + 0.5)


def smooth_views(
    views: Array,
    valid: Array | None,
    *,
    scale: float,
    deviation: float,
    views_out: Array,
    chosen: Sequence[int] | None = None,
) -> None:
    height, width = views.shape[1:3]
    for n, smoothed_out in zip(range(len(views)) if chosen is None else chosen, views_out, strict=True):
        view = views[n]
        known = np.ones((height, width), np.bool_) if valid is None else valid[n] != 0
        image, counts = np.where(known[..., None], scale * view.astype(np.float64), 0), known.astype(np.float64)
        guide = _sum_around(image) / np.maximum(_sum_around(counts[..., None]), 1)
        total, weights = np.zeros_like(image), np.zeros((height, width))
        for dy in range(-SMOOTHING_REACH, SMOOTHING_REACH + 1):
            for dx in range(-SMOOTHING_REACH, SMOOTHING_REACH + 1):
                rows, columns = np.arange(height) + dy, np.arange(width) + dx
                inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
                there = np.ix_(np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))
                unlike = counts * ((guide[there] - guide) ** 2).mean(2) / deviation**2
                weight = np.exp(-(dy**2 + dx**2) / _SPREAD) / (1 + unlike) ** 2 * inside * counts[there]
                total += weight[..., None] * image[there]
                weights += weight
        smoothed_out[:] = _stored(total / np.where(weights > 0, weights, 1)[..., None])


def _sum_around(image: Array) -> Array:
    """Sums over 3 x 3 pixels of [y, x, c], the border repeated."""
    height, width = image.shape[:2]
    framed = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return np.sum([framed[dy : dy + height, dx : dx + width] for dy in range(3) for dx in range(3)], axis=0)


def reduce_views(views: Array, valid: Array | None, *, scale: float, views_out: Array, valid_out: Array | None) -> None:
    n, height, width, channels = views_out.shape
    rows, columns = height * REDUCTION, width * REDUCTION
    known = np.ones(views.shape[:3], np.bool_) if valid is None else valid != 0
    blocks = views[:, :rows, :columns].reshape(n, height, REDUCTION, width, REDUCTION, channels).astype(np.float64)
    counts = known[:, :rows, :columns].reshape(n, height, REDUCTION, width, REDUCTION, 1)
    sums = np.where(counts, blocks, 0).sum((2, 4))
    views_out[:] = _stored(scale * sums / np.maximum(counts.sum((2, 4)), 1))
    if valid_out is not None:
        valid_out[:] = counts.all((2, 4, 5))
