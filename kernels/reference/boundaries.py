"""Pixels at outlines that show a little of what is nearer: NumPy, float64, one neighbour after the other.

Where an outline runs through a pixel, its colour is a mixture, and that moves with what is nearer: in all views the
pixel looks as it does here, if only what is nearer is followed. So matching gives it to what is nearer, however little
of it there is, and outlines grow. How much there is the colour tells, between those of both sides.

It is light that adds up in a pixel, and recorded intensities are about its root: amounts are compared in squares. What
is nearer often curves away at its outline, and is darker there than beside it: its colour is that of a plane through
the colours of its pixels, where that meets the outline.
"""

import numpy as np

from lfgpu.contract import REACH, Float64Array as Array, half_window

SPREAD = 3.0  # pixels²: how fast neighbours count less with their distance
BESIDE = 1e-3  # what a pixel counts that may itself be a mixture
RIDGE = 0.3  # pixels²: variance of places below which the plane through colours becomes level


def extremes(disparity: Array) -> tuple[Array, Array]:
    """Compute the least and the largest disparity of the pixels around each, itself included, that lie in the image."""
    padded = np.pad(disparity, 1, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return np.asarray(around.min(axis=(2, 3))), np.asarray(around.max(axis=(2, 3)))


def refine_boundaries(
    image: Array, disparity: Array, *, step: float, contrast: float, share: float, disparity_out: Array
) -> None:
    (height, width), channels = disparity.shape, image.shape[2]
    lowest, highest = extremes(disparity)
    behind_ends, front_ends = disparity - lowest > step, highest - disparity > step
    light = image**2
    # Of each side: sums of the weights; of the front also those times x, y, xx, xy, yy, light, and light times x and y.
    front, behind = np.zeros((height, width, 6 + 3 * channels)), np.zeros((height, width, 2 + channels))
    for dy, dx in (sign * offset for offset in half_window(2 * REACH + 1) for sign in (1, -1)):
        here = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
        there = np.s_[max(0, dy) : height + min(0, dy), max(0, dx) : width + min(0, dx)]
        if dy**2 + dx**2 > REACH**2 or not disparity[here].size:
            continue
        weight, apart = np.exp(-(dy**2 + dx**2) / SPREAD), disparity[there] - disparity[here]
        same = weight * ((np.abs(apart) <= step) & ~behind_ends[there])
        farther = weight * (apart < -step) * np.where(front_ends[there], BESIDE, 1)
        place = np.broadcast_to([1.0, dx, dy, dx * dx, dx * dy, dy * dy], (*apart.shape, 6))
        front[here] += same[..., None] * np.concatenate([place, *(n * light[there] for n in (1, dx, dy))], 2)
        behind[here] += farther[..., None] * np.concatenate(
            [place[..., :1], disparity[there][..., None], light[there]], 2
        )
    known = behind_ends & (front[..., 0] > 0) & (behind[..., 0] > 0)
    front, behind = front[known] / front[known][:, :1], behind[known] / behind[known][:, :1]
    x, y, xx, xy, yy = front[:, 1:6].T
    xx, xy, yy = xx - x * x + RIDGE, xy - x * y, yy - y * y + RIDGE
    right, down = np.array([yy * x - xy * y, xx * y - xy * x])[..., None] / (xx * yy - xy * xy)[:, None]
    colors, by_x, by_y = np.split(front[:, 6:], 3, axis=1)
    nearer = (1 + right * x[:, None] + down * y[:, None]) * colors - right * by_x - down * by_y
    nearer, back = np.maximum(nearer, 0), behind[:, 2:]
    apart = nearer - back
    square, product = (apart**2).sum(1), (apart * (light[known] - back)).sum(1)
    seen = ((np.sqrt(nearer) - np.sqrt(back)) ** 2).sum(1) > channels * contrast**2
    disparity_out[:] = disparity
    disparity_out[known] = np.where(seen & (product < share * square), behind[:, 1], disparity[known])
