"""Sums with non-local-means weights that also depend on a map: a ratio, a plane; `kernels/reference` says which."""

import taichi as ti

from .landing import inside
from .memory import flat, operation
from .nlm import step_after, step_of


@ti.func
def _shared(weight: float, apart: float, support: float):
    return weight / (1.0 + (apart / support) * (apart / support))


@operation
@ti.kernel
def nlm_ratio(
    weights: flat(),
    guide: flat(),
    numerator: flat(),
    denominator: flat(),
    height: int,
    width: int,
    window: int,
    support: float,
    floor: float,
    ratio_out: flat(),
):
    """Compute a pixel on each thread: its two sums stay there."""
    size = height * width
    for p in range(ratio_out.shape[0]):
        x = p % width
        y = p // width
        here = guide[p]
        above = numerator[p]
        below = denominator[p] + floor
        step = step_of(0, window // 2)
        for k in range(weights.shape[0] // size):
            for sign in ti.static((1, -1)):
                if inside(x + sign * step[0], y + sign * step[1], height, width):
                    q = p + sign * (step[1] * width + step[0])
                    v = _shared(weights[k * size + ti.min(p, q)], guide[q] - here, support)
                    above += v * numerator[q]
                    below += v * (denominator[q] + floor)
            step = step_after(step, window // 2)
        ratio_out[p] = above / below


@ti.func
def _moments(u: float, apart: float, x: int, y: int):
    """Compute the terms that a neighbour adds to the sums of a regression."""
    return ti.Vector([u, u * x, u * y, u * x * x, u * x * y, u * y * y, u * apart, u * apart * x, u * apart * y])


@operation
@ti.kernel
def nlm_plane(
    weights: flat(),
    values: flat(),
    certainty: flat(),
    height: int,
    width: int,
    window: int,
    support: float,
    ridge: float,
    plane_out: flat(),
):
    """Compute a pixel on each thread: the sums of its regression stay there."""
    size = height * width
    for p in range(plane_out.shape[0]):
        here = values[p]
        sums = _moments(certainty[p], 0.0, 0, 0)
        step = step_of(0, window // 2)
        for k in range(weights.shape[0] // size):
            for sign in ti.static((1, -1)):
                x = sign * step[0]
                y = sign * step[1]
                if inside(p % width + x, p // width + y, height, width):
                    q = p + y * width + x
                    apart = values[q] - here
                    u = _shared(weights[k * size + ti.min(p, q)], apart, support) * certainty[q]
                    sums += _moments(u, apart, x, y)
            step = step_after(step, window // 2)
        means = sums / sums[0]
        x = means[1]
        y = means[2]
        xx = means[3] - x * x + ridge
        xy = means[4] - x * y
        yy = means[5] - y * y + ridge
        along_x = means[7] - x * means[6]
        along_y = means[8] - y * means[6]
        determinant = xx * yy - xy * xy
        slope_x = (along_x * yy - along_y * xy) / determinant
        slope_y = (along_y * xx - along_x * xy) / determinant
        plane_out[p] = here + means[6] - slope_x * x - slope_y * y


@operation
@ti.kernel
def nlm_on_surface(
    weights: flat(), guide: flat(), height: int, width: int, window: int, support: float, weights_out: flat()
):
    size = height * width
    for i in range(weights_out.shape[0]):
        k = i // size
        p = i - k * size
        step = step_of(k, window // 2)
        weight = 0.0
        if inside(p % width + step[0], p // width + step[1], height, width):
            weight = _shared(weights[i], guide[p + step[1] * width + step[0]] - guide[p], support)
        weights_out[i] = weight
