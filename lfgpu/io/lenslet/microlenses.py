"""The microlens lattice: where the centre of every microlens image lies on the sensor, found from a picture alone.

A lattice of bright discs has peaks in its power spectrum: six if it is hexagonal, four if it is square. They give
pitch, rotation and rows to a part of a bin (`spectrum`); the phases of the picture against two of them give all numbers
of the lattice (`phases`). Where there are few lenses, their middles are measured one by one (`spots`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.lenslet.lattice import Microlenses
from lfgpu.io.lenslet.phases import NEIGHBOURHOOD, fitted
from lfgpu.io.lenslet.spectrum import PITCHES, find_peaks
from lfgpu.io.lenslet.spots import find_spots

_LEAST_NEIGHBOURHOODS = 4  # along the shorter side, for their phases to tell a lattice


def find_microlenses(picture: NDArray[np.float32], *, name: str, expected: Microlenses | None = None) -> Microlenses:
    """Find the microlens lattice of a white image or a capture, float32 [y, x], bright where the lenses are.

    Where the picture agrees with what the camera says of the lattice, `expected` but for its origin, no other one is
    looked for. `along` is within 45 degrees of x; if the rows stand upright, it is a step of a row of the transposed
    picture (`is_upright`). LightFieldError if there is no lattice, or not the same one all over the picture.
    """
    middle = np.array([(picture.shape[1] - 1) / 2, (picture.shape[0] - 1) / 2])
    if expected is not None:
        waves = np.linalg.inv(np.stack([expected.along, expected.down], axis=1))
        try:
            return fitted(picture, waves, expected.pitch, name=name).reduced(name=name).near(middle)
        except LightFieldError:  # another camera's metadata, or a cropped picture: it is looked for
            pass
    peaks = find_peaks(picture)
    few = peaks is None or min(picture.shape) < _LEAST_NEIGHBOURHOODS * NEIGHBOURHOOD * peaks.pitch
    if few and (spots := find_spots(picture, name=name)) is not None:
        return spots.reduced(name=name).near(middle)
    if peaks is None:
        raise LightFieldError(
            f"{name} shows no microlenses: a raw capture of a lenslet camera has a hexagonal or square lattice of "
            f"bright spots {PITCHES[0]:g} to {PITCHES[1]:g} px apart, and its spectrum peaks; there are none that "
            "stand out."
        )
    return fitted(picture, peaks.frequencies[:2], peaks.pitch, name=name).reduced(name=name).near(middle)


def is_upright(grid: Microlenses) -> bool:
    """Tell whether the rows of a hexagonal lattice are nearer to the direction of y than to that of x."""
    return not grid.square and abs(math.sin(grid.rotation)) > math.sin(math.radians(15))
