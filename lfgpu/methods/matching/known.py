"""Pixels that the reference view recorded, and those that it did not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Array, Float32Array
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.arena import Arena


class KnownPixels:
    """The mask of the reference view on the device. Without masks all pixels are known, and nothing is done.

    Parameters
    ----------
    arena
        Where buffers come from.
    layout
        The layout of the views.
    """

    def __init__(self, arena: Arena, layout: ViewLayout) -> None:
        self._arena, self._kernels, self._size = arena, arena.kernels, layout.size
        self.mask: NDArray[np.bool_] | None = None if layout.masks is None else layout.masks[layout.reference]
        """The mask of the reference view, bool [y, x]; None if all pixels are known."""
        self._known = None if self.mask is None else arena.constant("known", self.mask)

    def putting(self, value: float) -> Callable[[Array], None]:
        """Plan to give the unknown pixels of maps [y, x] a value."""
        if self._known is None:
            return lambda map_: None
        known, other = self._known, self._arena.constant(f"all {value}", np.full(self._size, value))
        return lambda map_: self._kernels.select(known, map_, other, map_)

    def take_out(self, values: Array) -> None:
        """Make values [y, x] 0 at unknown pixels."""
        if self._known is not None:
            self._kernels.multiply(values, self._known, values)

    def on_host(self, values: Float32Array) -> Float32Array:
        """Put NaN at the unknown pixels of a map [y, x] on the host."""
        return values if self.mask is None else np.where(self.mask, values, np.float32(np.nan))
