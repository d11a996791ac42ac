"""The splat with occlusions: NumPy, float64, one view at a time.

Where several pixels land on one, the nearest shall be seen. A soft z-buffer takes the mean of their colours, weighted
by exp(sharpness * disparity) besides the tent: differentiable, and independent of how many land there. Weights are
relative to the nearest one's, found first, which cancels in the mean but keeps them between 0 and 1.
"""

import numpy as np

from lfgpu.contract import Float64Array as Array

from .splat import Tap, taps

LEAST_WEIGHT = 1e-20  # what gives less is not there: quotients of such weights stay within float32


def reaching_taps(disparity: Array, offset: Array, softness: float) -> list[Tap]:
    """Return the taps of every reference pixel in one view, as far as they reach their targets."""
    found = []
    for tap in taps(disparity, offset, softness):
        reaches = tap.weight > LEAST_WEIGHT
        inside = tap.inside.copy()
        inside[tap.inside] = reaches
        rows, columns = tap.target
        found.append(Tap(inside, (rows[reaches], columns[reaches]), tap.weight[reaches], tap.slope[reaches]))
    return found


def nearest(disparity: Array, found: list[Tap]) -> Array:
    """Compute the z-buffer of one view [y, x]: the largest disparity that reaches a pixel, -inf where none does."""
    depth = np.full(disparity.shape, -np.inf)
    for tap in found:
        np.maximum.at(depth, tap.target, disparity[tap.inside])
    return depth


def _blend(image: Array, disparity: Array, offset: Array, softness: float, sharpness: float) -> tuple[Array, Array]:
    """Compute one view as a mean of what lands on its pixels, and its coverage."""
    found = reaching_taps(disparity, offset, softness)
    front = nearest(disparity, found)
    coverage, total, view = np.zeros(disparity.shape), np.zeros(disparity.shape), np.zeros(image.shape)
    for tap in found:
        weight = tap.weight * np.exp(sharpness * (disparity[tap.inside] - front[tap.target]))
        np.add.at(coverage, tap.target, tap.weight)
        np.add.at(total, tap.target, weight)
        np.add.at(view, tap.target, weight[:, None] * image[tap.inside])
    return view / np.where(total > 0, total, 1)[..., None], coverage


def splat_z_buffered(
    image: Array,
    disparity: Array,
    offsets: Array,
    *,
    softness: float,
    sharpness: float,
    views_out: Array,
    coverage_out: Array,
) -> None:
    for view, coverage, offset in zip(views_out, coverage_out, offsets, strict=True):
        view[:], coverage[:] = _blend(image, disparity, offset, softness, sharpness)
