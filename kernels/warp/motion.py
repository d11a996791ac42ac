"""Motion of the reference view from frame to frame, as `kernels/reference/motion.py` defines it."""

from types import SimpleNamespace
from typing import Any

import warp as wp

from .memory import pixel_type
from .pixels import Field, pixelwise
from .threads import once

wp.set_module_options({"enable_backward": False})

_RADIUS = 5  # pixels: the window is 11 x 11
_STEPS = 2
_FARTHEST = 2.0  # pixels, along each axis, that a pixel may have moved
_EXPLAINED = 0.08  # of the squared differences of a window, that motion must explain
_RIDGE = 1e-5  # squared gradients of a window without texture, intensity²
_BESIDE = 5  # pixels to those whose motion is tried as well
_BETTER = 0.8  # of the change with the own motion, below which another one is taken
_SLIP = 0.4  # pixels by which motion may be wrong: so much of the gradients is no change

Sums = wp.types.vector(length=6, dtype=wp.float32)
"""Sums over a window: squared gradients xx, xy and yy, gradients times the difference in x and y, and its square."""
_Sums: Any = wp.array2d(dtype=Sums)
_Motion: Any = wp.array2d(dtype=wp.vec2)


@once
def _kernels(channels: int) -> SimpleNamespace:
    pixel = pixel_type(channels)

    @wp.func
    def at(last: wp.array2d(dtype=pixel), y: float, x: float):
        """Compute the last frame at any place, linear between pixels; beyond its border the border goes on."""
        height = last.shape[0]
        width = last.shape[1]
        cy = wp.clamp(y, 0.0, float(height - 1))
        cx = wp.clamp(x, 0.0, float(width - 1))
        top = int(cy)
        left = int(cx)
        bottom = wp.min(top + 1, height - 1)
        right = wp.min(left + 1, width - 1)
        ay = cy - float(top)
        ax = cx - float(left)
        upper = (1.0 - ax) * last[top, left] + ax * last[top, right]
        lower = (1.0 - ax) * last[bottom, left] + ax * last[bottom, right]
        return (1.0 - ay) * upper + ay * lower

    @wp.func
    def mean(value: pixel):
        total = float(0.0)
        for c in range(wp.static(channels)):
            total = total + value[c]
        return total / wp.static(float(channels))

    @wp.func
    def gradient_x(image: wp.array2d(dtype=pixel), y: int, x: int):
        return 0.5 * (image[y, wp.min(x + 1, image.shape[1] - 1)] - image[y, wp.max(x - 1, 0)])

    @wp.func
    def gradient_y(image: wp.array2d(dtype=pixel), y: int, x: int):
        return 0.5 * (image[wp.min(y + 1, image.shape[0] - 1), x] - image[wp.max(y - 1, 0), x])

    @wp.func
    def change(image: wp.array2d(dtype=pixel), last: wp.array2d(dtype=pixel), y: int, x: int, w: wp.vec2):
        """Mean absolute change over 3 x 3 pixels and the channels, along a motion."""
        total = float(0.0)
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                v = wp.clamp(y + dy, 0, image.shape[0] - 1)
                u = wp.clamp(x + dx, 0, image.shape[1] - 1)
                difference = image[v, u] - at(last, float(v) + w[1], float(u) + w[0])
                for c in range(wp.static(channels)):
                    total = total + wp.abs(difference[c])
        return total / wp.static(9.0 * channels)

    @wp.func
    def steepness(image: wp.array2d(dtype=pixel), y: int, x: int):
        """Mean absolute gradient over 3 x 3 pixels and the channels, both directions added."""
        total = float(0.0)
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                v = wp.clamp(y + dy, 0, image.shape[0] - 1)
                u = wp.clamp(x + dx, 0, image.shape[1] - 1)
                gx = gradient_x(image, v, u)
                gy = gradient_y(image, v, u)
                for c in range(wp.static(channels)):
                    total = total + wp.abs(gx[c]) + wp.abs(gy[c])
        return total / wp.static(9.0 * channels)

    @pixelwise(f"lfgpu_motion_products_{channels}")
    def products(
        y: int,
        x: int,
        image: wp.array2d(dtype=pixel),
        last: wp.array2d(dtype=pixel),
        motion: _Motion,
        products_out: _Sums,
    ):
        w = motion[y, x]
        gx = mean(gradient_x(image, y, x))
        gy = mean(gradient_y(image, y, x))
        error = mean(image[y, x] - at(last, float(y) + w[1], float(x) + w[0]))
        target = error + gx * w[0] + gy * w[1]
        products_out[y, x] = Sums(gx * gx, gx * gy, gy * gy, gx * target, gy * target, error * error)

    @pixelwise(f"lfgpu_motion_choose_{channels}")
    def choose(
        y: int,
        x: int,
        image: wp.array2d(dtype=pixel),
        last: wp.array2d(dtype=pixel),
        found: _Motion,
        tolerance: float,
        motion_out: _Motion,
        same_out: Field,
    ):
        best = found[y, x]
        least = change(image, last, y, x, best)
        bound = wp.static(_BETTER) * least
        for k in range(9):
            v = wp.clamp(y + (k / 3 - 1) * wp.static(_BESIDE), 0, image.shape[0] - 1)
            u = wp.clamp(x + (k % 3 - 1) * wp.static(_BESIDE), 0, image.shape[1] - 1)
            other = found[v, u]
            if k == 4:
                other = wp.vec2(0.0, 0.0)
            value = change(image, last, y, x, other)
            if value < bound:
                bound = value
                least = value
                best = other
        allowed = tolerance
        if best[0] != 0.0 or best[1] != 0.0:
            allowed = allowed + wp.static(_SLIP) * steepness(image, y, x)
        ratio = least / allowed
        square = ratio * ratio
        motion_out[y, x] = best
        same_out[y, x] = 1.0 / (1.0 + square * square * square * square)

    return SimpleNamespace(products=products, choose=choose)


@pixelwise("lfgpu_motion_across")
def _add_across(y: int, x: int, products: _Sums, sums_out: _Sums):
    total = Sums()
    for dx in range(-wp.static(_RADIUS), wp.static(_RADIUS + 1)):
        total = total + products[y, wp.clamp(x + dx, 0, products.shape[1] - 1)]
    sums_out[y, x] = total


@pixelwise("lfgpu_motion_solve")
def _solve(y: int, x: int, sums: _Sums, is_first: int, motion: _Motion):
    total = Sums()
    for dy in range(-wp.static(_RADIUS), wp.static(_RADIUS + 1)):
        total = total + sums[wp.clamp(y + dy, 0, sums.shape[0] - 1), x]
    xx = total[0] + wp.static(_RIDGE)
    yy = total[2] + wp.static(_RIDGE)
    scale = 1.0 / (xx * yy - total[1] * total[1])
    wx = (yy * total[3] - total[1] * total[4]) * scale
    wy = (xx * total[4] - total[1] * total[3]) * scale
    before = motion[y, x]
    moves = before[0] != 0.0 or before[1] != 0.0
    if is_first == 1:
        moves = wx * total[3] + wy * total[4] > wp.static(_EXPLAINED) * total[5]
    if moves:
        wx = wp.clamp(wx, -wp.static(_FARTHEST), wp.static(_FARTHEST))
        wy = wp.clamp(wy, -wp.static(_FARTHEST), wp.static(_FARTHEST))
        motion[y, x] = wp.vec2(wx, wy)


@pixelwise("lfgpu_motion_carry")
def _carry(
    y: int,
    x: int,
    motion: _Motion,
    past: Field,
    frames: Field,
    rate: Field,
    confidence: Field,
    support: float,
    past_out: Field,
    frames_out: Field,
    rate_out: Field,
    confidence_out: Field,
):
    height = past.shape[0]
    width = past.shape[1]
    w = motion[y, x]
    cx = wp.clamp(float(x) + w[0], 0.0, float(width - 1))
    cy = wp.clamp(float(y) + w[1], 0.0, float(height - 1))
    top = int(cy)
    left = int(cx)
    ay = cy - float(top)
    ax = cx - float(left)
    nearest = past[int(cy + 0.5), int(cx + 0.5)]
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    weights = float(0.0)
    for k in range(4):
        v = wp.min(top + k / 2, height - 1)
        u = wp.min(left + k % 2, width - 1)
        weight = wp.where(k / 2 == 0, 1.0 - ay, ay) * wp.where(k % 2 == 0, 1.0 - ax, ax)
        if wp.abs(past[v, u] - nearest) <= support:
            total = total + weight * wp.vec4(past[v, u], frames[v, u], rate[v, u], confidence[v, u])
            weights = weights + weight
    total = total / weights
    past_out[y, x] = total[0] + total[2]
    frames_out[y, x] = total[1]
    rate_out[y, x] = total[2]
    confidence_out[y, x] = total[3]


class motion:
    """The motion in images of one size and kind (`lfgpu.contract.streaming.Motion`)."""

    def __init__(self, image: Any) -> None:
        self._kernels = _kernels(image.dtype._length_)
        self._found, self._motion = (wp.zeros(image.shape, dtype=wp.vec2, device=image.device) for _ in range(2))
        self._products, self._sums = (wp.zeros(image.shape, dtype=Sums, device=image.device) for _ in range(2))

    def find(self, image: Any, last: Any, *, tolerance: float, same_out: Any) -> None:
        self._found.zero_()
        for step in range(_STEPS):
            self._kernels.products(image, last, self._found, self._products)
            _add_across(self._products, self._sums)
            _solve(self._sums, int(step == 0), self._found)
        self._kernels.choose(image, last, self._found, tolerance, self._motion, same_out)

    def carry(self, *maps: Any, **named: Any) -> None:
        _carry(self._motion, *maps, **named)
