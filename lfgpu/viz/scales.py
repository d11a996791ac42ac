"""The ends of the scales on which maps are shown."""

import numpy as np
from numpy.typing import NDArray

_TAIL = 0.002  # share of outliers at each end that lie beyond the scale; pointed ends of the colour bar show them

ERRORS = -0.07, 0.07
"""The scale of all errors of disparities: its ends are the coarsest threshold of the benchmark."""


def scale_limits(values: NDArray[np.float32]) -> tuple[float, float]:
    """Choose the ends of the scale of a map: its range without a few outliers; (0, 1) if it is undefined everywhere."""
    defined = values[np.isfinite(values)]
    if defined.size == 0:
        return 0.0, 1.0
    low, high = (float(value) for value in np.quantile(defined, (_TAIL, 1 - _TAIL)))
    return (low, high) if high > low else (low - 0.5, high + 0.5)
