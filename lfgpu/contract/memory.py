"""Arrays and numbers on a device, and what they hold."""

import math
import threading
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array, Scalar

_here = threading.local()


def take_host_memory(size: int, count: int) -> None:
    """Take memory for `count` arrays of `size` bytes from the system, for this thread's next calls of `host_memory`.

    What was taken before is let go of. To write to pages for the first time takes many times as long as to write to
    them again.
    """
    _here.taken = [np.ones(size, np.uint8) for _ in range(count)]


def host_memory(shape: Sequence[int], dtype: Any) -> NDArray[Any]:
    """Return an array like `numpy.empty`, in memory that was taken before if its size is the same."""
    taken, size = getattr(_here, "taken", None), math.prod(shape) * np.dtype(dtype).itemsize
    if not taken or len(taken[-1]) != size:
        return np.empty(shape, dtype)
    return taken.pop().view(dtype).reshape(shape)


class Memory(Protocol):
    """Arrays on a device: making, writing and reading them."""

    def devices(self) -> tuple[str, ...]:
        """Names of the devices that can be used here, the default first."""

    def field(self, values: NDArray[Any], device: str) -> Array:
        """Return a copy of `values` (any shape) on the device as scalars of `dtype`."""

    def image(self, values: NDArray[Any], device: str) -> Array:
        """`values` [..., c] (uint8, uint16, float16, float32) on the device as they are stored; c is 1 or 3, and any
        number for the volumes of `Learned`.
        """

    def zeros(self, shape: Sequence[int], device: str) -> Array:
        """Return a field of zeros."""

    def zeros_image(self, shape: Sequence[int], device: str, stored: Any = np.float32) -> Array:
        """Return an image of zeros of the NumPy type `stored`; `shape` is [..., c]."""

    def within(self, home: Array, shape: Sequence[int], stored: Any = None) -> Array | None:
        """Return a field, or an image of the NumPy type `stored`, that lies in the memory of an array which is larger.

        None where arrays of a backend cannot share memory.
        """

    def clear(self, array_out: Array) -> Array:
        """Set a field or an image to zeros, and return it."""

    def scalar(self, value: float, device: str) -> Scalar:
        """Return a number on the device."""

    def upload(self, values: NDArray[Any], array_out: Array, *, chosen: Sequence[int] | None = None) -> None:
        """New contents of a field or an image, of the same shape and, for an image, the type that it is stored in.

        With `chosen`, the indices along the first axis of the values that are taken, in that order; all by default.
        A backend may also take arrays of other libraries (`__dlpack__` or `__cuda_array_interface__`) on the device
        itself, and then copies there: after what their library was asked for before, and before what it is asked for
        later.
        """

    def shared(self, field: Array) -> Any:
        """Return the field itself as an array that other libraries take without a copy: `__dlpack__`, and on the host
        `__array_interface__`, on a GPU `__cuda_array_interface__`; who takes it reads it after what was asked for
        before. BackendError where a backend has no such arrays.
        """

    def numpy(self, array: Array) -> NDArray[Any]:
        """Copy a field or an image to a NumPy array with the channels last; wait for the device.

        Large arrays from a GPU come in `host_memory`.
        """

    def number(self, scalar: Scalar) -> float:
        """Read a scalar; wait for the device."""

    def read(self, array: Array, scalar: Scalar) -> tuple[NDArray[Any], float]:
        """Do what `numpy` and `number` do, but wait for the device once."""
