"""Means over the channels of views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def mean_of_channels(values: NDArray[Any], dtype: type[np.floating]) -> NDArray[Any]:
    """Average along the last axis, which is so short that NumPy is slow to add it up: float [...] of `dtype`."""
    total = values[..., 0].astype(dtype)
    for c in range(1, values.shape[-1]):
        total += values[..., c]
    return np.asarray(total / dtype(values.shape[-1]))
