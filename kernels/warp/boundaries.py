"""Pixels at outlines that show a little of what is nearer; `kernels/reference/boundaries.py` says why and which."""

from typing import Any

import warp as wp

from lfgpu.contract import REACH

from .memory import pixel_type
from .pixels import Field, Number, pixelwise
from .threads import once

wp.set_module_options({"enable_backward": False})

_SPREAD = 3.0  # pixels²: how fast neighbours count less with their distance
_BESIDE = 1e-3  # what a pixel counts that may itself be a mixture
_RIDGE = 0.3  # pixels²: variance of places below which the plane through colours becomes level


@wp.func
def _reaches(disparity: wp.array2d(dtype=float), y: int, x: int, step: float, sign: float):
    """True if one of the pixels around is farther than this one by more than `step`; nearer, if `sign` is -1."""
    here = sign * disparity[y, x]
    found = bool(False)
    for j in range(wp.max(y - 1, 0), wp.min(y + 2, disparity.shape[0])):
        for i in range(wp.max(x - 1, 0), wp.min(x + 2, disparity.shape[1])):
            if here - sign * disparity[j, i] > step:
                found = True
                break
        if found:
            break
    return found


@once
def _unmix(channels: int) -> Any:
    pixel = pixel_type(channels)

    @pixelwise(f"lfgpu_outlines_{channels}")
    def unmix(
        y: int,
        x: int,
        image: wp.array2d(dtype=pixel),
        disparity: Field,
        step: float,
        contrast: Number,
        share: float,
        disparity_out: Field,
    ):
        here = disparity[y, x]
        result = here
        if _reaches(disparity, y, x, step, 1.0):
            front = pixel()
            front_by_x = pixel()
            front_by_y = pixel()
            behind = pixel()
            front_weight = float(0.0)
            behind_weight = float(0.0)
            depth = float(0.0)
            mx = float(0.0)
            my = float(0.0)
            xx = float(0.0)
            xy = float(0.0)
            yy = float(0.0)
            for qy in range(wp.max(y - wp.static(REACH), 0), wp.min(y + wp.static(REACH + 1), disparity.shape[0])):
                for qx in range(wp.max(x - wp.static(REACH), 0), wp.min(x + wp.static(REACH + 1), disparity.shape[1])):
                    right = float(qx - x)
                    down = float(qy - y)
                    away = right * right + down * down
                    if away > 0.0 and away <= wp.static(float(REACH * REACH)):
                        apart = disparity[qy, qx] - here
                        weight = wp.exp(away * wp.static(-1.0 / _SPREAD))
                        if apart < -step:
                            if _reaches(disparity, qy, qx, step, -1.0):
                                weight = weight * wp.static(_BESIDE)
                            behind_weight = behind_weight + weight
                            depth = depth + weight * apart
                            behind = behind + weight * wp.cw_mul(image[qy, qx], image[qy, qx])
                        elif apart <= step and not _reaches(disparity, qy, qx, step, 1.0):
                            light = weight * wp.cw_mul(image[qy, qx], image[qy, qx])
                            front_weight = front_weight + weight
                            mx = mx + weight * right
                            my = my + weight * down
                            xx = xx + weight * right * right
                            xy = xy + weight * right * down
                            yy = yy + weight * down * down
                            front = front + light
                            front_by_x = front_by_x + right * light
                            front_by_y = front_by_y + down * light
            if front_weight > 0.0 and behind_weight > 0.0:
                mx = mx / front_weight
                my = my / front_weight
                xx = xx / front_weight - mx * mx + wp.static(_RIDGE)
                xy = xy / front_weight - mx * my
                yy = yy / front_weight - my * my + wp.static(_RIDGE)
                scale = 1.0 / (xx * yy - xy * xy)
                right = (yy * mx - xy * my) * scale
                down = (xx * my - xy * mx) * scale
                plane = (1.0 + right * mx + down * my) * front - right * front_by_x - down * front_by_y
                square = float(0.0)
                product = float(0.0)
                seen = float(0.0)
                for c in range(wp.static(channels)):
                    nearer = wp.max(plane[c] / front_weight, 0.0)
                    back = behind[c] / behind_weight
                    difference = nearer - back
                    square = square + difference * difference
                    product = product + difference * (image[y, x][c] * image[y, x][c] - back)
                    root = wp.sqrt(nearer) - wp.sqrt(back)
                    seen = seen + root * root
                if seen > wp.static(float(channels)) * contrast * contrast and product < share * square:
                    result = here + depth / behind_weight
        disparity_out[y, x] = result

    return unmix


def refine_boundaries(image: Any, *arguments: Any, **named: Any) -> None:
    _unmix(image.dtype._length_)(image, *arguments, **named)
