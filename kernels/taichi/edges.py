"""Weights that are small beside steps in brightness; `kernels/reference/edges.py` says which."""

from typing import Any

import taichi as ti

from .memory import DeviceArray, flat, operation
from .runtime import once


@once
def _kernel(channels: int) -> Any:
    @ti.func
    def step_between(image: ti.template(), p: int, q: int):
        size = 0.0
        for c in ti.static(range(channels)):
            size += ti.abs(image[p][c] - image[q][c])
        return size / channels

    @ti.kernel
    def weigh_kernel(
        image: flat(channels=channels),
        weight: float,
        contrast: float,
        reach: int,
        height: int,
        width: int,
        weights_out: flat(),
    ):
        for p in range(weights_out.shape[0]):
            left = ti.max(p % width - reach, 0)
            right = ti.min(p % width + reach, width - 1)
            top = ti.max(p // width - reach, 0)
            bottom = ti.min(p // width + reach, height - 1)
            largest = 0.0
            for y in range(top, bottom + 1):
                for x in range(left, right + 1):
                    q = y * width + x
                    if x < right:
                        largest = ti.max(largest, step_between(image, q, q + 1))
                    if y < bottom:
                        largest = ti.max(largest, step_between(image, q, q + width))
            share = largest / contrast
            weights_out[p] = weight / (1.0 + share * share)

    return weigh_kernel


weigh_edges = operation(_kernel, "channels")
"""`weight` times `edge_weights`."""


def edge_weights(image: DeviceArray, *, contrast: float, reach: int, weights_out: DeviceArray) -> None:
    weigh_edges(image, 1.0, contrast, reach, weights_out=weights_out)
