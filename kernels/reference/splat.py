"""The forward splat and its data term: NumPy, float64, one tap at a time.

Each reference pixel p lands at p - d(p) * (du, dv) in the view with offset (du, dv) and gives its colour to the up to
four pixels around, by Λ in x times Λ in y (Sajjadi et al. 2016, eq. of the generative model; Λ from `tent`).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array as Array


def tent(a: Array, softness: float) -> Array:
    """Λ(a) for a in [0, 1]; `softness` is ε in (0, 0.5]."""
    s = 1.0 / (1.0 - softness)
    line = 1.0 + s * (0.5 * softness - a)
    top = 1.0 - s * a**2 / (2.0 * softness)
    foot = s * (1.0 - a) ** 2 / (2.0 * softness)
    return np.where(a <= softness, top, np.where(a >= 1.0 - softness, foot, line))


def tent_slope(a: Array, softness: float) -> Array:
    """Λ'(a) for a in [0, 1]."""
    s = 1.0 / (1.0 - softness)
    return -s * np.minimum(np.minimum(a, 1.0 - a) / softness, 1.0)


class Tap(NamedTuple):
    """One of the four pixels that each reference pixel gives to: where, how much, and the derivative by disparity."""

    inside: NDArray[np.bool_]  # [y, x], the target lies in the frame
    target: tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and columns of the targets inside
    weight: Array  # weights of those inside
    slope: Array  # d weight / d disparity of those inside


def taps(disparity: Array, offset: Array, softness: float) -> Iterator[Tap]:
    """Compute the four taps of every reference pixel in the view with `offset` (du, dv)."""
    height, width = disparity.shape
    rows, columns = np.mgrid[:height, :width]
    du, dv = offset
    shift_x, shift_y = -disparity * du, -disparity * dv
    whole_x, whole_y = np.floor(shift_x), np.floor(shift_y)
    ax, ay = shift_x - whole_x, shift_y - whole_y
    wx, wy = tent(ax, softness), tent(ay, softness)
    sx, sy = -du * tent_slope(ax, softness), -dv * tent_slope(ay, softness)
    for right, weight_x, slope_x in ((0, wx, sx), (1, 1.0 - wx, -sx)):
        for below, weight_y, slope_y in ((0, wy, sy), (1, 1.0 - wy, -sy)):
            x = columns + whole_x.astype(np.int64) + right
            y = rows + whole_y.astype(np.int64) + below
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            slope = slope_x * weight_y + weight_x * slope_y
            yield Tap(inside, (y[inside], x[inside]), (weight_x * weight_y)[inside], slope[inside])


def splat(image: Array, disparity: Array, offsets: Array, softness: float) -> Array:
    """Predict views [n, y, x, c]."""
    views = np.zeros((len(offsets), *image.shape))
    for view, offset in zip(views, offsets, strict=True):
        for tap in taps(disparity, offset, softness):
            np.add.at(view, tap.target, tap.weight[:, None] * image[tap.inside])
    return views


def _gradient(image: Array, disparity: Array, residual: Array, offsets: Array, softness: float) -> Array:
    """Compute the gradient [y, x] with respect to the disparity that residuals [n, y, x, c] give."""
    gradient = np.zeros(disparity.shape)
    for view, offset in zip(residual, offsets, strict=True):
        for tap in taps(disparity, offset, softness):
            gradient[tap.inside] += tap.slope * (image[tap.inside] * view[tap.target]).sum(1)
    return gradient


class data_term:
    """The squared error of what a reference image predicts, and its gradient with respect to the disparity."""

    def __init__(self, shape: Sequence[int], offsets: Array, *, scale: float, softness: float) -> None:
        self._offsets, self._scale, self._softness = offsets, scale, softness

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid

    def __call__(self, disparity: Array, gradient_out: Array, value_out: Array) -> None:
        image, offsets, softness = self._image, self._offsets, self._softness
        residual = splat(image, disparity, offsets, softness) - self._scale * self._recorded
        if self._valid is not None:
            residual[self._valid == 0] = 0
        gradient_out[:] = 2 * _gradient(image, disparity, residual, offsets, softness)
        value_out[0] = np.vdot(residual, residual)

    def curvature(self, curvature_out: Array) -> None:
        curvature_out[:] = 2 * (self._offsets**2).sum() * (self._image**2).sum(-1)


def seen_by_reference(
    disparity: Array, offsets: Array, known: Array | None, valid: Array | None, *, seen_out: Array
) -> None:
    height, width = disparity.shape
    rows, columns = np.mgrid[:height, :width]
    for n, (du, dv) in enumerate(offsets):
        x, y = columns + disparity * du, rows + disparity * dv
        seen = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        if known is not None:
            row, column = (np.rint(place[seen]).astype(np.intp) for place in (y, x))
            seen[seen] = known[row, column] != 0
        if valid is not None:
            seen &= valid[n] != 0
        seen_out[n] = seen
