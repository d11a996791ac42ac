"""Motion from one frame to the next, and what is known of surfaces carried along it: NumPy, float64.

A pixel at p now was at p + w in the last frame. w minimises the squared differences of grey values over a window (Lucas
and Kanade 1981), found by Gauss-Newton steps from w = 0. It stays 0 where motion explains hardly more of the window
than the noise does. A window at the outline of what moves holds both sides; a pixel there takes the w of a pixel beside
it, or 0, if that fits clearly better.
"""

import numpy as np

from lfgpu.contract import Float64Array as Array

from .nlm import central_differences

RADIUS = 5  # pixels: the window is 11 x 11
STEPS = 2
FARTHEST = 2.0  # pixels, along each axis, that a pixel may have moved
EXPLAINED = 0.08  # of the squared differences of a window, that motion must explain
RIDGE = 1e-5  # squared gradients of a window without texture, intensity²
BESIDE = 5  # pixels to those whose motion is tried as well
BETTER = 0.8  # of the change with the own motion, below which another one is taken
SLIP = 0.4  # pixels by which motion may be wrong: so much of the gradients is no change


def _at(image: Array, y: Array, x: Array) -> Array:
    """Sample an image [y, x, c] at any places, linear between pixels; beyond its border the border goes on."""
    height, width = image.shape[:2]
    y, x = y.clip(0, height - 1), x.clip(0, width - 1)
    top, left = y.astype(np.intp), x.astype(np.intp)
    bottom, right = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    ay, ax = (y - top)[..., None], (x - left)[..., None]
    upper = (1 - ax) * image[top, left] + ax * image[top, right]
    lower = (1 - ax) * image[bottom, left] + ax * image[bottom, right]
    return (1 - ay) * upper + ay * lower


def _box(values: Array, radius: int) -> Array:
    """Sums over (2 radius + 1)² pixels of [y, x, ...]; borders go on."""
    height, width = values.shape[:2]
    padded = np.pad(values, ((radius, radius), (radius, radius), *((0, 0) for _ in values.shape[2:])), mode="edge")
    across = np.sum([padded[:, k : k + width] for k in range(2 * radius + 1)], axis=0)
    return np.asarray(np.sum([across[k : k + height] for k in range(2 * radius + 1)], axis=0))


def _solved(image: Array, last: Array, motion: Array, *, is_first: bool) -> Array:
    """Compute the motion [y, x, 2] after a Gauss-Newton step."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(float)
    gx, gy = (gradient.mean(2) for gradient in central_differences(image))
    error = (image - _at(last, y + motion[..., 1], x + motion[..., 0])).mean(2)
    target = error + gx * motion[..., 0] + gy * motion[..., 1]
    products = np.stack([gx * gx, gx * gy, gy * gy, gx * target, gy * target, error * error], axis=2)
    xx, xy, yy, xt, yt, square = np.moveaxis(_box(products, RADIUS), 2, 0)
    xx, yy = xx + RIDGE, yy + RIDGE
    scale = 1 / (xx * yy - xy * xy)
    found = np.stack([(yy * xt - xy * yt) * scale, (xx * yt - xy * xt) * scale], axis=2)
    moves = found[..., 0] * xt + found[..., 1] * yt > EXPLAINED * square if is_first else motion.any(2)
    return np.where(np.expand_dims(moves, 2), found.clip(-FARTHEST, FARTHEST), motion)


def _change(image: Array, last: Array, motion: Array) -> Array:
    """Average the absolute change [y, x] over 3 x 3 pixels and the channels, along the motion of the middle pixel."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width]
    total = np.zeros((height, width))
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            v, u = (y + dy).clip(0, height - 1), (x + dx).clip(0, width - 1)
            total += np.abs(image[v, u] - _at(last, v + motion[..., 1], u + motion[..., 0])).mean(2)
    return total / 9


class motion:
    """The motion in images of one size and kind (`lfgpu.contract.streaming.Motion`)."""

    def __init__(self, image: Array) -> None:
        self._motion = np.zeros((*image.shape[:2], 2))

    def find(self, image: Array, last: Array, *, tolerance: float, same_out: Array) -> None:
        found = np.zeros(self._motion.shape)
        for step in range(STEPS):
            found = _solved(image, last, found, is_first=step == 0)
        height, width = image.shape[:2]
        y, x = np.mgrid[:height, :width]
        best, least = found.copy(), _change(image, last, found)
        bound = BETTER * least
        for k in range(9):
            v, u = (y + (k // 3 - 1) * BESIDE).clip(0, height - 1), (x + (k % 3 - 1) * BESIDE).clip(0, width - 1)
            other = np.zeros_like(found) if k == 4 else found[v, u]
            change = _change(image, last, other)
            better = change < bound
            bound, least = np.where(better, change, bound), np.where(better, change, least)
            best = np.where(better[..., None], other, best)
        across, down = (np.abs(gradient).mean(2) for gradient in central_differences(image))
        steepness = _box(across + down, 1) / 9
        allowed = tolerance + np.where(best.any(2), SLIP * steepness, 0)
        self._motion[:] = best
        same_out[:] = 1 / (1 + (least / allowed) ** 8)

    def carry(
        self,
        past: Array,
        frames: Array,
        rate: Array,
        confidence: Array,
        *,
        support: float,
        past_out: Array,
        frames_out: Array,
        rate_out: Array,
        confidence_out: Array,
    ) -> None:
        height, width = past.shape
        y, x = np.mgrid[:height, :width]
        cx = (x + self._motion[..., 0]).clip(0, width - 1)
        cy = (y + self._motion[..., 1]).clip(0, height - 1)
        top, left = cy.astype(np.intp), cx.astype(np.intp)
        nearest = past[(cy + 0.5).astype(np.intp), (cx + 0.5).astype(np.intp)]
        known = np.stack([past, frames, rate, confidence], axis=2)
        total, weights = np.zeros(known.shape), np.zeros(past.shape)
        for dy, of_row in ((0, 1 - (cy - top)), (1, cy - top)):
            for dx, of_column in ((0, 1 - (cx - left)), (1, cx - left)):
                v, u = np.minimum(top + dy, height - 1), np.minimum(left + dx, width - 1)
                weight = np.where(np.abs(past[v, u] - nearest) <= support, of_row * of_column, 0)
                total += weight[..., None] * known[v, u]
                weights += weight
        total /= weights[..., None]
        past_out[:] = total[..., 0] + total[..., 2]
        frames_out[:], rate_out[:], confidence_out[:] = np.moveaxis(total[..., 1:], 2, 0)
