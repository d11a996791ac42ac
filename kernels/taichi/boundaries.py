"""Pixels at outlines that show a little of what is nearer; `kernels/reference/boundaries.py` says why and which."""

from typing import Any

import taichi as ti

from lfgpu.contract import REACH

from .memory import flat, operation
from .runtime import once

_SPREAD = 3.0  # pixels²: how fast neighbours count less with their distance
_BESIDE = 1e-3  # what a pixel counts that may itself be a mixture
_RIDGE = 0.3  # pixels²: variance of places below which the plane through colours becomes level


@ti.func
def _reaches(disparity: ti.template(), y: int, x: int, height: int, width: int, step: float, sign: float):
    """True if one of the pixels around is farther than this one by more than `step`; nearer, if `sign` is -1."""
    here = sign * disparity[y * width + x]
    found = False
    for j in range(ti.max(y - 1, 0), ti.min(y + 2, height)):
        for i in range(ti.max(x - 1, 0), ti.min(x + 2, width)):
            if here - sign * disparity[j * width + i] > step:
                found = True
    return found


@once
def _unmix_kernel(channels: int) -> Any:
    pixel = ti.types.vector(channels, ti.f32)

    @ti.kernel
    def unmix_kernel(
        image: flat(channels=channels),
        disparity: flat(),
        height: int,
        width: int,
        step: float,
        contrast: float,
        share: float,
        disparity_out: flat(),
    ):
        for p in range(disparity_out.shape[0]):
            x = p % width
            y = p // width
            here = disparity[p]
            result = here
            if _reaches(disparity, y, x, height, width, step, 1.0):
                front = pixel(0.0)
                front_by_x = pixel(0.0)
                front_by_y = pixel(0.0)
                behind = pixel(0.0)
                front_weight = 0.0
                behind_weight = 0.0
                depth = 0.0
                mx = 0.0
                my = 0.0
                xx = 0.0
                xy = 0.0
                yy = 0.0
                for qy in range(ti.max(y - REACH, 0), ti.min(y + REACH + 1, height)):
                    for qx in range(ti.max(x - REACH, 0), ti.min(x + REACH + 1, width)):
                        dx = ti.cast(qx - x, ti.f32)
                        dy = ti.cast(qy - y, ti.f32)
                        away = dx * dx + dy * dy
                        if away > 0.0 and away <= REACH * REACH:
                            q = qy * width + qx
                            apart = disparity[q] - here
                            weight = ti.exp(away * (-1.0 / _SPREAD))
                            if apart < -step:
                                if _reaches(disparity, qy, qx, height, width, step, -1.0):
                                    weight = weight * _BESIDE
                                behind_weight += weight
                                depth += weight * apart
                                behind += weight * image[q] * image[q]
                            elif apart <= step and not _reaches(disparity, qy, qx, height, width, step, 1.0):
                                light = weight * image[q] * image[q]
                                front_weight += weight
                                mx += weight * dx
                                my += weight * dy
                                xx += weight * dx * dx
                                xy += weight * dx * dy
                                yy += weight * dy * dy
                                front += light
                                front_by_x += dx * light
                                front_by_y += dy * light
                if front_weight > 0.0 and behind_weight > 0.0:
                    mx /= front_weight
                    my /= front_weight
                    xx = xx / front_weight - mx * mx + _RIDGE
                    xy = xy / front_weight - mx * my
                    yy = yy / front_weight - my * my + _RIDGE
                    scale = 1.0 / (xx * yy - xy * xy)
                    right = (yy * mx - xy * my) * scale
                    down = (xx * my - xy * mx) * scale
                    plane = (1.0 + right * mx + down * my) * front - right * front_by_x - down * front_by_y
                    square = 0.0
                    product = 0.0
                    seen = 0.0
                    for c in ti.static(range(channels)):
                        nearer = ti.max(plane[c] / front_weight, 0.0)
                        back = behind[c] / behind_weight
                        difference = nearer - back
                        square += difference * difference
                        product += difference * (image[p][c] * image[p][c] - back)
                        root = ti.sqrt(nearer) - ti.sqrt(back)
                        seen += root * root
                    if seen > channels * contrast * contrast and product < share * square:
                        result = here + depth / behind_weight
            disparity_out[p] = result

    return unmix_kernel


refine_boundaries = operation(_unmix_kernel, "channels")
