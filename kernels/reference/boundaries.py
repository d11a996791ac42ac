"""Pixels at outlines that show a little of what is nearer: NumPy, float64, one neighbour after the other.

Where an outline runs through a pixel, its colour is a mixture, and that moves with what is nearer: in all views the
pixel looks as it does here, if only what is nearer is followed. So matching gives it to what is nearer, however little
of it there is, and outlines grow. How much there is the colour tells, between those of both sides.
"""

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import REACH, half_window

Array = NDArray[np.float64]

SPREAD = 0.7  # pixels²: how fast neighbours count less with their distance
BESIDE = 1e-3  # what a pixel counts that may itself be a mixture


def extremes(disparity: Array) -> tuple[Array, Array]:
    """The least and the largest disparity of the pixels around each, itself included, that lie in the image."""
    padded = np.pad(disparity, 1, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return np.asarray(around.min(axis=(2, 3))), np.asarray(around.max(axis=(2, 3)))


def refine_boundaries(
    image: Array, disparity: Array, *, step: float, contrast: float, share: float, disparity_out: Array
) -> None:
    (height, width), channels = disparity.shape, image.shape[2]
    lowest, highest = extremes(disparity)
    behind_ends, front_ends = disparity - lowest > step, highest - disparity > step
    front, behind = np.zeros((height, width, channels + 1)), np.zeros((height, width, channels + 2))
    for dy, dx in (sign * offset for offset in half_window(2 * REACH + 1) for sign in (1, -1)):
        here = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
        there = np.s_[max(0, dy) : height + min(0, dy), max(0, dx) : width + min(0, dx)]
        if not disparity[here].size:
            continue
        weight, apart = np.exp(-(dy**2 + dx**2) / SPREAD), disparity[there] - disparity[here]
        same = weight * ((np.abs(apart) <= step) & ~behind_ends[there])
        farther = weight * (apart < -step) * np.where(front_ends[there], BESIDE, 1)
        ones = np.ones((*apart.shape, 1))
        front[here] += same[..., None] * np.concatenate([image[there], ones], 2)
        behind[here] += farther[..., None] * np.concatenate([image[there], disparity[there][..., None], ones], 2)
    known = behind_ends & (front[..., -1] > 0) & (behind[..., -1] > 0)
    disparity_out[:] = disparity
    nearer, back = front[known] / front[known][:, -1:], behind[known] / behind[known][:, -1:]
    apart = nearer[:, :channels] - back[:, :channels]
    square, product = (apart**2).sum(1), (apart * (image[known] - back[:, :channels])).sum(1)
    little = (square > channels * contrast**2) & (product < share * square)
    disparity_out[known] = np.where(little, back[:, channels], disparity[known])
