"""The operations of streams (`lfgpu/contract/streaming.py`): the traffic, and the past of a map."""

from typing import Any

import warp as wp

from .motion import Motion as motion  # noqa: N813 - the contract's name for what makes one
from .threads import launch_rows
from .transport import Transport as transport  # noqa: N813 - the contract's name for what makes one

__all__ = ["bias", "blend", "motion", "transport"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _bias_kernel(
    past: wp.array2d(dtype=float),
    trust: wp.array2d(dtype=float),
    first: float,
    step: float,
    strength: float,
    reach: float,
    row: int,
    lanes: int,
    volume: wp.array3d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, volume.shape[2], lanes):
        weight = strength * trust[y, x] / reach
        place = (past[y, x] - first) / step
        for k in range(volume.shape[0]):
            volume[k, y, x] = volume[k, y, x] + weight * wp.min(wp.abs(float(k) - place), reach)


@wp.kernel
def _blend_kernel(
    past: wp.array2d(dtype=float),
    same: wp.array2d(dtype=float),
    frames: wp.array2d(dtype=float),
    rate: wp.array2d(dtype=float),
    persistence: float,
    support: float,
    steady: float,
    rate_gain: float,
    row: int,
    lanes: int,
    frames_out: wp.array2d(dtype=float),
    rates_out: wp.array2d(dtype=float),
    weights_out: wp.array2d(dtype=float),
    disparity: wp.array2d(dtype=float),
):
    i = wp.tid()
    y = row + i / lanes
    for x in range(i % lanes, disparity.shape[1], lanes):
        innovation = disparity[y, x] - past[y, x]
        change = innovation / support
        square = change * change
        goes_on = same[y, x] / (1.0 + square * square)
        drift = rate[y, x] / steady
        before = persistence * goes_on * frames[y, x] / (1.0 + drift * drift)
        weight = goes_on * before / (1.0 + before)
        disparity[y, x] = past[y, x] + innovation / (1.0 + before)
        frames_out[y, x] = 1.0 + before
        rates_out[y, x] = weight * (rate[y, x] + rate_gain * innovation)
        weights_out[y, x] = weight


def bias(past: Any, trust: Any, volume: Any, *, first: float, step: float, strength: float, reach: float) -> None:
    """volume [l, y, x] += strength * trust * min(|first + l step - past| / step, reach) / reach."""
    launch_rows(_bias_kernel, [past, trust, first, step, strength, reach], volume)


def blend(
    past: Any,
    same: Any,
    frames: Any,
    rate: Any,
    disparity: Any,
    *,
    persistence: float,
    support: float,
    steady: float,
    rate_gain: float,
    frames_out: Any,
    rates_out: Any,
    weights_out: Any,
) -> None:
    inputs = [past, same, frames, rate, persistence, support, steady, rate_gain]
    launch_rows(_blend_kernel, inputs, frames_out, rates_out, weights_out, disparity)
