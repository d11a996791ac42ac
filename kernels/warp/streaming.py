"""The operations of streams (`lfgpu/contract/streaming.py`): the traffic, and the past of a map."""

import warp as wp

from .motion import motion
from .pixels import Field, Volume, pixelwise
from .transport import transport

__all__ = ["bias", "blend", "motion", "transport"]


@pixelwise("lfgpu_bias")
def bias(
    y: int,
    x: int,
    past: Field,
    trust: Field,
    volume: Volume,
    first: float,
    step: float,
    strength: float,
    reach: float,
):
    weight = strength * trust[y, x] / reach
    place = (past[y, x] - first) / step
    for k in range(volume.shape[0]):
        volume[k, y, x] = volume[k, y, x] + weight * wp.min(wp.abs(float(k) - place), reach)


@pixelwise("lfgpu_blend")
def blend(
    y: int,
    x: int,
    past: Field,
    same: Field,
    frames: Field,
    rate: Field,
    disparity: Field,
    persistence: float,
    support: float,
    steady: float,
    rate_gain: float,
    frames_out: Field,
    rates_out: Field,
    weights_out: Field,
):
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
