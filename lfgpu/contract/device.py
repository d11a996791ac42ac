"""A device of a backend: where arrays live and operations run."""

from collections.abc import Callable, Hashable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array, Scalar
from lfgpu.contract.backend import KernelSet

Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Device:
    """A device with the operations of a backend that run on it.

    Parameters
    ----------
    kernels
        The operations of the backend.
    name
        The name of the device: "cpu", "cuda:0" and so on.
    """

    kernels: KernelSet
    name: str

    @property
    def is_gpu(self) -> bool:
        """True if the device has memory of its own."""
        return self.name != "cpu"

    def zeros(self, shape: Sequence[int]) -> Array:
        """Return a field of zeros."""
        return self.kernels.zeros(shape, self.name)

    def zeros_image(self, shape: Sequence[int], stored: Any = np.float32) -> Array:
        """Return an image [..., c] of zeros of the NumPy type `stored`."""
        return self.kernels.zeros_image(shape, self.name, stored)

    def field(self, values: NDArray[Any]) -> Array:
        """Return a copy of `values` (any shape) as a field."""
        return self.kernels.field(values, self.name)

    def image(self, values: NDArray[Any]) -> Array:
        """Return a copy of `values` [..., c] as an image, as they are stored."""
        return self.kernels.image(values, self.name)

    def scalar(self, value: float) -> Scalar:
        """Return a number on the device."""
        return self.kernels.scalar(value, self.name)

    def kept(
        self, name: Hashable, key: Hashable, make: Callable[[], Kept], fits: Callable[[Kept], bool] | None = None
    ) -> Kept:
        """Make something that needs memory; a device that keeps such things returns the last of that key if it fits."""
        return make()

    def asking(self) -> AbstractContextManager[object]:
        """Return the context in which the device is asked for work; see `Control.asking`."""
        return self.kernels.asking(self.name)
