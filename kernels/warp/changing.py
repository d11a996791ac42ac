"""Scalars that planned work reads its numbers from; `lfgpu/contract/changing.py` says which."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import Disparities


class numbers:
    def __init__(self, count: int, device: str) -> None:
        self._all, self._values = wp.zeros(count, dtype=wp.float64, device=device), np.zeros(count)
        self.scalars = [self._all[i : i + 1] for i in range(count)]

    def change(self, values: Sequence[float]) -> None:
        self._values[: len(values)] = values
        self._all.assign(self._values)


def move(sweep: Any, disparities: Disparities) -> None:
    sweep.move(disparities)
