"""Arrays of the Taichi backend: all values in one row, since kernels spend less on indices that they work out alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from lfgpu.errors import BackendError

from .runtime import alone, start

_SCALARS: dict[type, Any] = {np.uint8: ti.u8, np.uint16: ti.u16, np.float32: ti.f32}
_MOST = 2**31 - 1  # Taichi's indices have 32 bits


@dataclass(frozen=True, eq=False)
class DeviceArray:
    """A field of scalars, or an image of pixels with `channels` values each: its elements in row order."""

    values: ti.Ndarray
    shape: tuple[int, ...]
    channels: int | None = None
    scalar: Any = ti.f32

    @property
    def size(self) -> int:
        """The number of scalars or pixels."""
        return prod(self.shape)


def flat(scalar: Any = ti.f32, channels: int | None = None) -> Any:
    """The type of kernel arguments that are a `DeviceArray`'s values."""
    return ti.types.ndarray(dtype=scalar if channels is None else ti.types.vector(channels, scalar), ndim=1)


def empty(shape: Sequence[int], *, channels: int | None = None, scalar: Any = ti.f32) -> DeviceArray:
    """A new array on the running device, of whatever the memory held."""
    count = prod(shape)
    if count * (channels or 1) > _MOST:
        raise BackendError(
            f"backend 'taichi' cannot hold an array of {count * (channels or 1)} values, at most {_MOST}: use fewer or "
            "smaller views, or backend 'warp'."
        )
    with alone():
        values = ti.ndarray(scalar, count) if channels is None else ti.Vector.ndarray(channels, scalar, count)
    return DeviceArray(values, tuple(shape), channels, scalar)


def field(values: NDArray[Any], device: str) -> DeviceArray:
    start(device)
    return _filled(empty(values.shape), np.asarray(values, np.float32))


def image(values: NDArray[Any], device: str) -> DeviceArray:
    start(device)
    return _filled(
        empty(values.shape[:-1], channels=values.shape[-1], scalar=_SCALARS[values.dtype.type]), np.asarray(values)
    )


def zeros(shape: Sequence[int], device: str) -> DeviceArray:
    start(device)
    return clear(empty(shape))


def zeros_image(shape: Sequence[int], device: str) -> DeviceArray:
    start(device)
    return clear(empty(shape[:-1], channels=shape[-1]))


def clear(array: DeviceArray) -> DeviceArray:
    """The array, all 0."""
    with alone():
        array.values.fill(0)
    return array


def numpy(array: DeviceArray) -> NDArray[Any]:
    with alone():
        values: NDArray[Any] = array.values.to_numpy()
    return values.reshape(array.shape if array.channels is None else (*array.shape, array.channels))


def _filled(array: DeviceArray, values: NDArray[Any]) -> DeviceArray:
    elements = values.reshape(array.size, *(() if array.channels is None else (array.channels,)))
    with alone():
        array.values.from_numpy(np.ascontiguousarray(elements))
    return array
