"""The cases of the kernel matrix, as data, and the random inputs that are made of them.

Disparities, offsets and shears have so few binary digits that their products are exact in float32: every backend lands
at the same place, so that what differs is its arithmetic. `exact=False` leaves that out and says by how much the place
may differ.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT32_STEP = 2.0**-24  # half the distance of neighbouring float32 numbers around 1


@dataclass(frozen=True)
class Case:
    """A case of the matrix by its name, which its tests carry."""

    name: str

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


def grid(rows: int, columns: int) -> tuple[tuple[float, float], ...]:
    """Offsets (du, dv) of a grid of views from its middle one, which is among them."""
    return tuple((float(u - columns // 2), float(v - rows // 2)) for v in range(rows) for u in range(columns))


IRREGULAR = ((0.328125, -1.0), (-1.71875, 0.40625), (2.015625, 1.140625), (-0.046875, -2.28125))


def stored(intensities: NDArray[np.float64], dtype: str) -> NDArray[Any]:
    """Intensities in [0, 1] as a file of that dtype holds them."""
    if dtype.startswith("float"):
        return intensities.astype(dtype)
    return np.rint(intensities * np.iinfo(dtype).max).astype(dtype)


def scale_of(dtype: str) -> float:
    return 1.0 if dtype.startswith("float") else 1.0 / np.iinfo(dtype).max


def float32(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def coarse(values: NDArray[Any], step: float) -> NDArray[np.float32]:
    return float32(np.round(values / step) * step)
