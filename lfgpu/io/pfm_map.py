"""Maps as PFM: float32, as the HCI 4D benchmark takes them; nothing says what the values mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.result import DisparityMap
from lfgpu.io.pfm import read_pfm, write_pfm_to


def write(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """The values only."""
    write_pfm_to(path, np.asarray(values.disparity, np.float32))


def read(path: Path) -> DisparityMap:
    """A grey PFM."""
    return DisparityMap(read_pfm(path), name=path.name)
