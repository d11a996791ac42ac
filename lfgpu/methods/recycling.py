"""Devices whose memory serves one light field after another: to allocate takes a device longer than to clear."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from lfgpu.contract import Array, Device

_Kept = TypeVar("_Kept")


@dataclass(frozen=True)
class RecyclingDevice(Device):
    """A device that keeps the fields and images that it handed out, for the next plan of the same light fields."""

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


@dataclass(frozen=True)
class KeepingDevice(Device):
    """A device that keeps what measures light fields of one kind: of each name, what was made last."""

    _things: dict[Hashable, tuple[Hashable, Any]] = field(default_factory=dict, compare=False)

    def kept(
        self, name: Hashable, key: Hashable, make: Callable[[], _Kept], fits: Callable[[_Kept], bool] | None = None
    ) -> _Kept:
        if name in self._things:
            before, thing = self._things[name]
            if before == key and (fits is None or fits(thing)):
                return thing
            del self._things[name], thing  # its memory first
        made = make()
        self._things[name] = key, made
        return made
