"""How far a disparity can be trusted: what its costs say, and a share and a variance made of that. NumPy, float64."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHARPNESS = 2.0  # costs that differ by unit / SHARPNESS differ
LEAST_COST = 1.0  # units: views that differ by less than their noise say no more than that


def evidence(
    volume: Array, disparity: Array, *, first: float, step: float, unit: float, cost_out: Array, evidence_out: Array
) -> None:
    count = len(volume)
    place = np.clip((disparity - first) / step, 0, count - 1)
    below = np.minimum(place.astype(int), count - 2)
    part = place - below
    lower, upper = (np.take_along_axis(volume, (below + k)[None], 0)[0] for k in (0, 1))
    cost_out[:] = ((1 - part) * lower + part * upper) / unit
    rivals = np.exp(-SHARPNESS / unit * (volume - volume.min(0))).sum(0)
    evidence_out[:] = 1 / (step * rivals)


def judge(
    odds: Array,
    cost: Array,
    evidence: Array,
    *,
    share: Sequence[float],
    spread: Sequence[float],
    confidence_out: Array,
    variance_out: Array,
) -> None:
    features = np.ones_like(odds), -np.log(odds), np.log(np.maximum(cost, LEAST_COST)), np.log(evidence)
    confidence_out[:] = 1 / (1 + np.exp(-sum(weight * f for weight, f in zip(share, features, strict=True))))
    variance_out[:] = np.exp(sum(weight * f for weight, f in zip(spread, features, strict=True)))
