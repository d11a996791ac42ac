"""Two maps of the same views, and the choice between them: NumPy, float64. `lfgpu/contract` says what is computed."""

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import CLOSE, DECISIONS, LEAST_ODDS, Float64Array as Array

from .peak import unfolded
from .sectors import folded


def compare_maps(
    first: Sequence[Array], second: Sequence[Array], *, farthest: float, span: float, features_out: Array
) -> None:
    maps, confidences, variances, *means = (np.stack(pair) for pair in zip(first, second, strict=True))
    apart = farthest * (maps[1] - maps[0])
    features = [
        *np.log((confidences + LEAST_ODDS) / (1 - confidences + LEAST_ODDS)) / 4,
        *np.log((farthest * np.sqrt(variances)).clip(1e-3, 20)) / 3,
        np.arcsinh(apart / 0.05) / 4,
        np.log1p(np.abs(apart) / 0.03) / 4,
        *(layer for mean in means for layer in np.arcsinh(farthest * (maps - mean) / 0.1) / 4),
        np.full(apart.shape, np.log(farthest) / 2),
        np.full(apart.shape, np.log1p(farthest * span) / 4),
    ]
    folded(np.stack(features, -1), features_out[0])


def choose(
    decisions: Array,
    first: Array,
    second: Array,
    *,
    farthest: float,
    disparity_out: Array,
    confidence_out: Array,
    variance_out: Array,
) -> None:
    parts = np.split(decisions, DECISIONS, -1)
    choice, right, size = (unfolded(part, first.shape)[0] for part in parts)
    share = 1 / (1 + np.exp(-choice))
    is_close = farthest * np.abs(second - first) < CLOSE
    disparity_out[:] = first + np.where(is_close, share, share > 0.5) * (second - first)
    confidence_out[:] = 1 / (1 + np.exp(-right))
    variance_out[:] = np.exp(2 * size.clip(-7, 4)) / farthest**2
