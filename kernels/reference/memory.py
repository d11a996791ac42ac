"""Arrays of the reference backend: NumPy, float64, images with their channels last."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def devices() -> tuple[str, ...]:
    return ("cpu",)


def field(values: NDArray[Any], device: str) -> NDArray[np.float64]:
    return np.array(values, np.float64)


def zeros(shape: Sequence[int], device: str) -> NDArray[np.float64]:
    return np.zeros(shape)


def numpy(array: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array(array)


image = field
zeros_image = zeros
