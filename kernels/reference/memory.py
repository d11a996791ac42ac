"""Arrays and numbers of the reference backend: NumPy, float64, images with their channels last."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array as Array


def devices() -> tuple[str, ...]:
    return ("cpu",)


def field(values: NDArray[Any], device: str) -> Array:
    return np.array(values, np.float64)


def image(values: NDArray[Any], device: str) -> Array:
    return np.array(values, np.float64)


def zeros(shape: Sequence[int], device: str) -> Array:
    return np.zeros(shape)


def within(home: Array, shape: Sequence[int], stored: Any = None) -> None:
    return None


def zeros_image(shape: Sequence[int], device: str, stored: Any = np.float32) -> Array:
    return np.zeros(shape)


def clear(array_out: Array) -> Array:
    array_out[...] = 0
    return array_out


def scalar(value: float, device: str) -> Array:
    return np.array([value], np.float64)


def upload(values: NDArray[Any], array_out: Array, *, chosen: Sequence[int] | None = None) -> None:
    array_out[...] = values if chosen is None else values[list(chosen)]


def numpy(array: Array) -> Array:
    return np.array(array)


def shared(field: Array) -> Array:
    return field


def number(scalar: Array) -> float:
    return float(scalar[0])


def read(array: Array, scalar: Array) -> tuple[Array, float]:
    return numpy(array), number(scalar)
