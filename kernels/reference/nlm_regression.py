"""Sums with non-local-means weights that also depend on a map, a ratio and a plane: NumPy, float64."""

import numpy as np

from lfgpu.contract import Float64Array as Array, half_window

from .nlm import overlap


def nlm_ratio(
    weights: Array,
    guide: Array,
    numerator: Array,
    denominator: Array,
    *,
    window: int,
    support: float,
    floor: float,
    ratio_out: Array,
) -> None:
    height, width = guide.shape
    above, below = numerator.copy(), denominator + floor
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        shared = w[here] / (1 + ((guide[there] - guide[here]) / support) ** 2)
        for p, q in ((here, there), (there, here)):
            above[p] += shared * numerator[q]
            below[p] += shared * (denominator[q] + floor)
    ratio_out[:] = above / below


def nlm_plane(
    weights: Array,
    values: Array,
    certainty: Array,
    *,
    window: int,
    support: float,
    ridge: float,
    plane_out: Array,
) -> None:
    height, width = values.shape
    total, total_value = certainty.copy(), np.zeros(values.shape)
    first, moment = np.zeros((2, *values.shape)), np.zeros((2, *values.shape))  # sums of (x, y), and of these by values
    second = np.zeros((3, *values.shape))  # of x², x y and y²
    for w, (dy, dx) in zip(weights, half_window(window), strict=True):
        here, there = overlap((height, width), dy, dx)
        shared = w[here] / (1 + ((values[there] - values[here]) / support) ** 2)
        for p, q, x, y in ((here, there, dx, dy), (there, here, -dx, -dy)):
            u, apart = shared * certainty[q], values[q] - values[p]
            total[p] += u
            total_value[p] += u * apart
            for sums, factor in zip((*first, *second), (x, y, x * x, x * y, y * y), strict=True):
                sums[p] += u * factor
            for sums, factor in zip(moment, (x, y), strict=True):
                sums[p] += u * apart * factor
    middle_x, middle_y, middle = first[0] / total, first[1] / total, total_value / total
    xx = second[0] / total - middle_x**2 + ridge
    xy = second[1] / total - middle_x * middle_y
    yy = second[2] / total - middle_y**2 + ridge
    along_x, along_y = moment[0] / total - middle_x * middle, moment[1] / total - middle_y * middle
    determinant = xx * yy - xy**2
    slope_x, slope_y = (along_x * yy - along_y * xy) / determinant, (along_y * xx - along_x * xy) / determinant
    plane_out[:] = values + middle - slope_x * middle_x - slope_y * middle_y


def nlm_on_surface(weights: Array, guide: Array, *, window: int, support: float, weights_out: Array) -> None:
    for w, out, (dy, dx) in zip(weights, weights_out, half_window(window), strict=True):
        here, there = overlap(guide.shape, dy, dx)
        shared = w[here] / (1 + ((guide[there] - guide[here]) / support) ** 2)
        out[:] = 0
        out[here] = shared
