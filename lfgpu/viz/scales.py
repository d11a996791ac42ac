"""The ends of the scales on which maps are shown."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_TAIL = 0.002  # share of outliers at each end that lie beyond the scale; pointed ends of the colour bar show them
_LEAST_ERROR = 0.07  # smallest end of an error scale: the coarsest threshold of the benchmark


def scale_limits(values: NDArray[np.float32]) -> tuple[float, float]:
    """Choose the ends of the scale of a map: its range without a few outliers; (0, 1) if it is undefined everywhere."""
    defined = values[np.isfinite(values)]
    if defined.size == 0:
        return 0.0, 1.0
    low, high = (float(value) for value in np.quantile(defined, (_TAIL, 1 - _TAIL)))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def error_reach(error: NDArray[np.float32]) -> float:
    """Choose the end of a symmetric error scale: the 95 % quantile of the absolute error, rounded up to one digit."""
    defined = np.abs(error[np.isfinite(error)])
    reach = max(float(np.quantile(defined, 0.95)) if defined.size else 0.0, _LEAST_ERROR)
    digit = 10.0 ** math.floor(math.log10(reach))
    return round(math.ceil(reach / digit - 1e-9) * digit, 12)
