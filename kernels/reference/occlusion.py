"""The splat with occlusions, its data term, and what other views see: NumPy, float64, one view at a time.

Where several pixels land on one, the nearest shall be seen. A soft z-buffer takes the mean of their colours, weighted
by exp(sharpness * disparity) besides the tent: differentiable, and independent of how many land there. Weights are
relative to the nearest one's, found first, which cancels in the mean but keeps them between 0 and 1.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Loss

from .splat import Tap, taps

Array = NDArray[np.float64]

LEAST_WEIGHT = 1e-20  # what gives less is not there: quotients of such weights stay within float32


def reaching_taps(disparity: Array, offset: Array, softness: float) -> list[Tap]:
    """The taps of every reference pixel in one view, as far as they reach their targets."""
    found = []
    for tap in taps(disparity, offset, softness):
        reaches = tap.weight > LEAST_WEIGHT
        inside = tap.inside.copy()
        inside[tap.inside] = reaches
        rows, columns = tap.target
        found.append(Tap(inside, (rows[reaches], columns[reaches]), tap.weight[reaches], tap.slope[reaches]))
    return found


def nearest(disparity: Array, found: list[Tap]) -> Array:
    """The z-buffer of one view [y, x]: the largest disparity that reaches a pixel, -inf where none does."""
    depth = np.full(disparity.shape, -np.inf)
    for tap in found:
        np.maximum.at(depth, tap.target, disparity[tap.inside])
    return depth


class Blend:
    """One view as a mean of what lands on its pixels."""

    def __init__(self, image: Array, disparity: Array, offset: Array, softness: float, sharpness: float) -> None:
        self._image, self._sharpness = image, sharpness
        self._taps = reaching_taps(disparity, offset, softness)
        front = nearest(disparity, self._taps)
        self._nearness = [np.exp(sharpness * (disparity[tap.inside] - front[tap.target])) for tap in self._taps]
        self.coverage, total, self.view = np.zeros(disparity.shape), np.zeros(disparity.shape), np.zeros(image.shape)
        for tap, nearness in zip(self._taps, self._nearness, strict=True):
            weight = tap.weight * nearness
            np.add.at(self.coverage, tap.target, tap.weight)
            np.add.at(total, tap.target, weight)
            np.add.at(self.view, tap.target, weight[:, None] * image[tap.inside])
        self._total = np.where(total > 0, total, 1)
        self.view /= self._total[..., None]

    def gradient(self, residual: Array) -> Array:
        """The gradient [y, x] with respect to the disparity that the residuals [y, x, c] of the view give.

        With W = sum_p T_p w_p the view changes by dL/dd_p = (dT_p/dd_p + sharpness T_p) w_p (I_p - L) / W.
        """
        gradient = np.zeros(residual.shape[:2])
        for tap, nearness in zip(self._taps, self._nearness, strict=True):
            difference = self._image[tap.inside] - self.view[tap.target]
            change = (tap.slope + self._sharpness * tap.weight) * nearness / self._total[tap.target]
            gradient[tap.inside] += change * (difference * residual[tap.target]).sum(1)
        return gradient


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
        blend = Blend(image, disparity, offset, softness, sharpness)
        view[:], coverage[:] = blend.view, blend.coverage


LOSSES: dict[Loss, Callable[[Array, float], tuple[Array, Array]]] = {
    "squares": lambda square, scale: (square, np.ones_like(square)),
    "charbonnier": lambda square, scale: (
        2 * scale**2 * (np.sqrt(1 + square / scale**2) - 1),
        1 / np.sqrt(1 + square / scale**2),
    ),
    "geman-mcclure": lambda square, scale: (
        scale**2 * square / (scale**2 + square),
        (scale**2 / (scale**2 + square)) ** 2,
    ),
}
"""ρ and its derivative by r², of r² and the scale s."""


class OccludingDataTerm:
    """The loss of what a reference image predicts with occlusions, and its gradient with respect to the disparity."""

    def __init__(
        self,
        offsets: Array,
        scale: float,
        softness: float,
        sharpness: float,
        least_coverage: float,
        loss: Callable[[Array], tuple[Array, Array]],
    ) -> None:
        self._offsets, self._scale, self._softness, self._sharpness = offsets, scale, softness, sharpness
        self._least_coverage, self._loss = least_coverage, loss

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._image, self._recorded = image, recorded
        self._valid = np.ones(recorded.shape[:3]) if valid is None else valid

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Array) -> None:
        gradient_out[:] = 0
        value_out[0] = 0
        for recorded, valid, offset in zip(self._recorded, self._valid, self._offsets, strict=True):
            blend = Blend(self._image, disparity, offset, self._softness, self._sharpness)
            residual = blend.view - self._scale * recorded
            residual[(valid == 0) | (blend.coverage < self._least_coverage)] = 0
            loss, slope = self._loss((residual**2).sum(2))
            gradient_out += blend.gradient(2 * slope[..., None] * residual)
            value_out[0] += loss.sum()


def z_buffered_data_term(
    shape: Sequence[int],
    offsets: Array,
    *,
    scale: float,
    softness: float,
    sharpness: float,
    least_coverage: float,
    loss: Loss,
    loss_scale: float,
) -> OccludingDataTerm:
    function = LOSSES[loss]
    return OccludingDataTerm(
        offsets, scale, softness, sharpness, least_coverage, lambda square: function(square, loss_scale)
    )


def visible(disparity: Array, offsets: Array, *, tolerance: float, visible_out: Array) -> None:
    height, width = disparity.shape
    rows, columns = np.mgrid[:height, :width]
    for visible, (du, dv) in zip(visible_out, offsets, strict=True):
        found = reaching_taps(disparity, np.array([du, dv]), 0.5)  # whatever the softness, the same pixels are reached
        front = nearest(disparity, found)
        free = np.zeros(disparity.shape, np.bool_)
        for tap in found:
            free[tap.inside] |= front[tap.target] <= disparity[tap.inside] + tolerance
        x, y = columns - disparity * du, rows - disparity * dv
        visible[:] = free & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
