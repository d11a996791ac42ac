"""Planes through the pixels of a map, and the best of them; `kernels/reference/facets.py` says what they are."""

import taichi as ti

from lfgpu.contract import FACET_REACH

from .memory import flat, operation


@operation
@ti.kernel
def planes(map_: flat(), height: int, width: int, planes_out: flat()):
    for p in range(map_.shape[0]):
        x = p % width
        y = p // width
        top = ti.max(y - FACET_REACH, 0)
        bottom = ti.min(y + FACET_REACH + 1, height)
        left = ti.max(x - FACET_REACH, 0)
        right = ti.min(x + FACET_REACH + 1, width)
        here = map_[p]  # what differs from it is small, and keeps its digits
        middle_y = 0.5 * (top + bottom - 1)
        middle_x = 0.5 * (left + right - 1)
        count = ti.cast((bottom - top) * (right - left), float)
        total = 0.0
        total_y = 0.0
        total_x = 0.0
        spread_y = 0.0
        spread_x = 0.0
        for j in range(top, bottom):
            for i in range(left, right):
                value = map_[j * width + i] - here
                down = j - middle_y
                ahead = i - middle_x
                total += value
                total_y += down * value
                total_x += ahead * value
                spread_y += down * down
                spread_x += ahead * ahead
        mean = total / count
        by_y = total_y / ti.max(spread_y, 1e-6)
        by_x = total_x / ti.max(spread_x, 1e-6)
        residual = 0.0
        for j in range(top, bottom):
            for i in range(left, right):
                rest = map_[j * width + i] - here - (mean + by_y * (j - middle_y) + by_x * (i - middle_x))
                residual += rest * rest
        level = here + (mean + by_y * (y - middle_y) + by_x * (x - middle_x))
        planes_out[4 * p] = level
        planes_out[4 * p + 1] = by_x
        planes_out[4 * p + 2] = by_y
        planes_out[4 * p + 3] = residual / count


@operation
@ti.kernel
def facets(planes: flat(), height: int, width: int, facets_out: flat()):
    for p in range(facets_out.shape[0]):
        x = p % width
        y = p // width
        least = ti.math.inf
        found = 0.0
        for dy in range(-FACET_REACH, FACET_REACH + 1):
            for dx in range(-FACET_REACH, FACET_REACH + 1):
                row = ti.math.clamp(y + dy, 0, height - 1)
                column = ti.math.clamp(x + dx, 0, width - 1)
                q = 4 * (row * width + column)
                if planes[q + 3] < least:
                    least = planes[q + 3]
                    found = planes[q] + planes[q + 1] * (x - column) + planes[q + 2] * (y - row)
        facets_out[p] = found
