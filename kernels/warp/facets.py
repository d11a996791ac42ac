"""Planes through the pixels of a map, and the best of them; `kernels/reference/facets.py` says what they are."""

from typing import Any

import warp as wp

from lfgpu.contract import FACET_REACH

from .memory import pixel_type
from .pixels import Field, pixelwise

_REACH, _FAR = wp.constant(FACET_REACH), wp.constant(float("inf"))
_Planes: Any = wp.array2d(dtype=pixel_type(4))


@pixelwise("lfgpu_planes")
def planes(y: int, x: int, map_: Field, planes_out: _Planes):
    top = wp.max(y - _REACH, 0)
    bottom = wp.min(y + _REACH + 1, map_.shape[0])
    left = wp.max(x - _REACH, 0)
    right = wp.min(x + _REACH + 1, map_.shape[1])
    here = map_[y, x]  # what differs from it is small, and keeps its digits
    middle_y = 0.5 * float(top + bottom - 1)
    middle_x = 0.5 * float(left + right - 1)
    count = float((bottom - top) * (right - left))
    total = float(0.0)
    total_y = float(0.0)
    total_x = float(0.0)
    spread_y = float(0.0)
    spread_x = float(0.0)
    for j in range(top, bottom):
        for i in range(left, right):
            value = map_[j, i] - here
            down = float(j) - middle_y
            ahead = float(i) - middle_x
            total += value
            total_y += down * value
            total_x += ahead * value
            spread_y += down * down
            spread_x += ahead * ahead
    mean = total / count
    by_y = total_y / wp.max(spread_y, 1e-6)
    by_x = total_x / wp.max(spread_x, 1e-6)
    residual = float(0.0)
    for j in range(top, bottom):
        for i in range(left, right):
            plane = mean + by_y * (float(j) - middle_y) + by_x * (float(i) - middle_x)
            rest = map_[j, i] - here - plane
            residual += rest * rest
    level = here + (mean + by_y * (float(y) - middle_y) + by_x * (float(x) - middle_x))
    planes_out[y, x] = wp.vec4f(level, by_x, by_y, residual / count)


@pixelwise("lfgpu_facets")
def facets(y: int, x: int, planes: _Planes, facets_out: Field):
    least = float(_FAR)
    found = float(0.0)
    for dy in range(-_REACH, _REACH + 1):
        for dx in range(-_REACH, _REACH + 1):
            row = wp.clamp(y + dy, 0, facets_out.shape[0] - 1)
            column = wp.clamp(x + dx, 0, facets_out.shape[1] - 1)
            plane = planes[row, column]
            if plane[3] < least:
                least = plane[3]
                found = plane[0] + plane[1] * float(x - column) + plane[2] * float(y - row)
    facets_out[y, x] = found
