"""Two maps of the same views, and the choice between them; `kernels/reference/choice.py` says what they are."""

from collections.abc import Sequence
from typing import Any

import warp as wp

from lfgpu.contract import CLOSE, COMPARED, DECISIONS, FOLD, LEAST_ODDS

from .memory import pixel_type
from .pixels import Field, Number, pixelwise
from .threads import once

_LEAST_ODDS, _CLOSE = wp.constant(LEAST_ODDS), wp.constant(CLOSE)
_Features = wp.types.vector(length=COMPARED, dtype=float)


@wp.func
def _arsinh(x: float) -> float:
    size = wp.abs(x)
    return wp.sign(x) * wp.log(size + wp.sqrt(size * size + 1.0))


@wp.func
def _log_odds(confidence: float) -> float:
    return wp.log((confidence + _LEAST_ODDS) / (1.0 - confidence + _LEAST_ODDS))


@wp.func
def _log_deviation(variance: float, farthest: float) -> float:
    return wp.log(wp.clamp(farthest * wp.sqrt(variance), 1e-3, 20.0))


@once
def _compare(stored: Any) -> Any:
    folded: Any = pixel_type(FOLD**2 * COMPARED, stored)

    @pixelwise(f"lfgpu_compare_maps_{stored.__name__}")
    def compare(
        n: int,
        y: int,
        x: int,
        map_0: Field,
        confidence_0: Field,
        variance_0: Field,
        near_0: Field,
        wide_0: Field,
        map_1: Field,
        confidence_1: Field,
        variance_1: Field,
        near_1: Field,
        wide_1: Field,
        farthest: float,
        span: Number,
        features_out: wp.array3d(dtype=folded),
    ):
        result = folded()
        for i in range(wp.static(FOLD)):
            for j in range(wp.static(FOLD)):
                row = wp.min(wp.static(FOLD) * y + i, map_0.shape[0] - 1)
                column = wp.min(wp.static(FOLD) * x + j, map_0.shape[1] - 1)
                d0 = map_0[row, column]
                d1 = map_1[row, column]
                apart = farthest * (d1 - d0)
                found = _Features(
                    _log_odds(confidence_0[row, column]) / 4.0,
                    _log_odds(confidence_1[row, column]) / 4.0,
                    _log_deviation(variance_0[row, column], farthest) / 3.0,
                    _log_deviation(variance_1[row, column], farthest) / 3.0,
                    _arsinh(apart / 0.05) / 4.0,
                    wp.log(1.0 + wp.abs(apart) / 0.03) / 4.0,
                    _arsinh(farthest * (d0 - near_0[row, column]) / 0.1) / 4.0,
                    _arsinh(farthest * (d1 - near_1[row, column]) / 0.1) / 4.0,
                    _arsinh(farthest * (d0 - wide_0[row, column]) / 0.1) / 4.0,
                    _arsinh(farthest * (d1 - wide_1[row, column]) / 0.1) / 4.0,
                    wp.log(farthest) / 2.0,
                    wp.log(1.0 + farthest * span) / 4.0,
                )
                for c in range(wp.static(COMPARED)):
                    result[wp.static(FOLD**2) * c + wp.static(FOLD) * i + j] = stored(found[c])
        features_out[n, y, x] = result

    return compare


def compare_maps(first: Sequence[Any], second: Sequence[Any], *, farthest: float, span: Any, features_out: Any) -> None:
    _compare(features_out.dtype._wp_scalar_type_)(*first, *second, farthest, span, features_out)


@pixelwise("lfgpu_choose")
def choose(
    y: int,
    x: int,
    decisions: wp.array3d(dtype=pixel_type(FOLD**2 * DECISIONS)),
    first: Field,
    second: Field,
    farthest: float,
    disparity_out: Field,
    confidence_out: Field,
    variance_out: Field,
):
    found = decisions[0, y / wp.static(FOLD), x / wp.static(FOLD)]
    place = y % wp.static(FOLD) * wp.static(FOLD) + x % wp.static(FOLD)
    share = 1.0 / (1.0 + wp.exp(-found[place]))
    apart = second[y, x] - first[y, x]
    if farthest * wp.abs(apart) >= _CLOSE:
        share = wp.where(share > 0.5, 1.0, 0.0)
    disparity_out[y, x] = first[y, x] + share * apart
    confidence_out[y, x] = 1.0 / (1.0 + wp.exp(-found[wp.static(FOLD**2) + place]))
    deviation = wp.exp(wp.clamp(found[wp.static(2 * FOLD**2) + place], -7.0, 4.0)) / farthest
    variance_out[y, x] = deviation * deviation
