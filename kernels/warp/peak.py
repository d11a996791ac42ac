"""The peak of the distribution of each pixel over disparities; `kernels/reference/peak.py` says what it is."""

import math
from collections.abc import Sequence
from typing import Any

import warp as wp

from lfgpu.contract import FOLD, LEAST_ODDS, LEAST_WIDTH, PEAK_REACH, Rows

from .memory import pixel_type
from .native_code import c_type, kernel
from .pixels import Field, pixelwise
from .threads import launch, launch_slices

_LEAST_ODDS, _LEAST_WIDTH = wp.constant(LEAST_ODDS), wp.constant(LEAST_WIDTH)
_Weights = wp.types.vector(length=3, dtype=float)


def _kernel(stored: Any, on_cpu: bool) -> Any:
    file, name = ("peak.h", "find_peaks") if on_cpu else ("peak.cuh", "find_peak")
    numbers = {"FOLD": FOLD, "REACH": PEAK_REACH, "STORED": c_type(stored, for_vectors=on_cpu)}
    return kernel(file, name, wide=on_cpu, Logits=pixel_type(FOLD**2, stored), **numbers)


def peak(
    logits: Any,
    first: Any,
    *,
    step: float,
    disparity_out: Any,
    probability_out: Any,
    deviation_out: Any,
    rows: Rows | None = None,
) -> None:
    outputs, stored = [disparity_out, probability_out, deviation_out], logits.dtype._wp_scalar_type_
    top, bottom = (0, logits.shape[1]) if rows is None else (rows.first, rows.last)
    if not logits.device.is_cpu:
        height, width = first.shape
        begin, pixels = FOLD * top * width, (min(FOLD * bottom, height) - FOLD * top) * width
        launch(_kernel(stored, False), max(pixels, 0), [logits, first, step, begin], outputs, device=logits.device)
        return
    launch_slices(_kernel(stored, True), bottom - top, [logits, first, step, top], *outputs)


@pixelwise("lfgpu_judge_peak")
def _judge_peak(
    y: int,
    x: int,
    probability: Field,
    deviation: Field,
    step: float,
    share: _Weights,
    spread: _Weights,
    confidence_out: Field,
    variance_out: Field,
):
    odds = wp.log((probability[y, x] + _LEAST_ODDS) / (1.0 - probability[y, x] + _LEAST_ODDS))
    features = _Weights(1.0, odds, wp.log(deviation[y, x] / step + _LEAST_WIDTH))
    confidence_out[y, x] = 1.0 / (1.0 + wp.exp(-wp.dot(share, features)))
    variance_out[y, x] = step * step * wp.exp(wp.dot(spread, features))


def judge_peak(
    probability: Any,
    deviation: Any,
    *,
    step: float,
    limit: float,
    share: Sequence[float],
    spread: Sequence[float],
    **outputs: Any,
) -> None:
    at_limit = _Weights(share[0] + share[3] * math.log(limit / step), share[1], share[2])
    _judge_peak(probability, deviation, step, at_limit, _Weights(*spread), **outputs)
