"""White of uint16 views: cameras of 10, 12 or 14 bits do not fill the type that they are stored in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import each_view

_BITS = (8, 10, 12, 14)  # of what is stored in 16


def with_white(light_field: LightField) -> LightField:
    """Set `white`, with a note, where uint16 views use fewer bits than they have.

    Parameters of the methods are in units of intensity: in views that are taken for 16 times darker than they are,
    everything is noise to them.
    """
    if light_field.views.dtype != np.uint16 or light_field.white is not None:
        return light_field
    highest = np.zeros(len(light_field.views), np.int64)

    def look(index: int, view: NDArray[Any]) -> None:
        highest[index] = view.max()

    each_view(light_field.views, range(len(light_field.views)), look)
    largest = int(highest.max())
    bits = next((bits for bits in _BITS if largest < 1 << bits), 16)
    if bits == 16 or largest == 0:
        return light_field
    white = (1 << bits) - 1
    note = (
        f"The values go up to {largest} of 65535: they are taken for {bits} bits, {white} for white. If they are dark "
        "pictures of 16 bits, nothing is lost by that."
    )
    return replace(light_field, white=white, notes=(*light_field.notes, note))
