"""`RecyclingDevice`: a device whose buffers serve one plan after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lfgpu.contract import Array, Device


@dataclass(frozen=True)
class RecyclingDevice(Device):
    """A device that keeps the fields and images that it handed out, for the next plan of the same light fields.

    To allocate memory takes a device longer than to clear it.
    """

    _lent: dict[Any, list[Array]] = field(default_factory=dict, compare=False)
    _free: dict[Any, list[Array]] = field(default_factory=dict, compare=False)

    def zeros(self, shape: Sequence[int]) -> Array:
        return self._taken((tuple(shape), None), super().zeros)

    def zeros_image(self, shape: Sequence[int], stored: Any = np.float32) -> Array:
        return self._taken((tuple(shape), np.dtype(stored).name), lambda shape: Device.zeros_image(self, shape, stored))

    def begin(self) -> None:
        """Begin the next plan. Nothing may use what was handed out before."""
        self._free.clear()  # what the last plan had no use for
        self._free.update(self._lent)
        self._lent.clear()

    def _taken(self, kind: tuple[tuple[int, ...], str | None], make: Callable[[tuple[int, ...]], Array]) -> Array:
        free = self._free.get(kind)
        array = self.kernels.clear(free.pop()) if free else make(kind[0])
        self._lent.setdefault(kind, []).append(array)
        return array
