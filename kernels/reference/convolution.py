"""Convolutions of volumes: NumPy, float64, tap by tap."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float32Array, Rows

Array = NDArray[np.float64]


class Convolution:
    """The convolution with its weights [l, y, x, c_in, c_out]."""

    def __init__(
        self,
        weights: Float32Array,
        bias: Float32Array,
        device: str,
        *,
        strides: tuple[int, int, int] = (1, 1, 1),
        rectified: bool = False,
    ) -> None:
        self._weights, self._bias = weights.astype(np.float64), bias.astype(np.float64)
        self._strides, self._rectified = strides, rectified

    def __call__(self, volume: Array, added: Array | None, volume_out: Array, *, rows: Rows | None = None) -> None:
        labels, held, columns = volume_out.shape[:3]
        height = volume.shape[1] if rows is None else rows.all * self._strides[1]
        lines = np.arange(held) if rows is None else np.arange(rows.first, rows.last)
        sums = np.zeros((labels, len(lines), columns, 1)) + self._bias
        for weights, shifted in self._taps(volume, lines, height):
            sums += shifted @ weights
        if added is not None:
            high = held // added.shape[1] if rows is None else columns // added.shape[2]
            some = added[:, lines // high % added.shape[1]]
            sums += some.repeat(labels // len(added), 0).repeat(columns // added.shape[2], 2)
        volume_out[:, lines % held] = np.maximum(sums, 0) if self._rectified else sums

    def _taps(self, volume: Array, lines: NDArray[np.intp], height: int) -> Iterator[tuple[Array, Array]]:
        """Yield weights [c_in, c_out] and what they are for in some rows of the output, [l, y, x, c_in]."""
        (deep, high, wide), (labels, held, width) = self._weights.shape[:3], volume.shape[:3]
        padded = np.pad(volume, [(deep // 2, deep // 2), (0, 0), (wide // 2, wide // 2), (0, 0)])
        for tap in np.ndindex(deep, high, wide):
            rows = lines * self._strides[1] + tap[1] - high // 2
            there = padded[tap[0] : tap[0] + labels : self._strides[0]][:, rows % held]
            there = there[:, :, tap[2] : tap[2] + width : self._strides[2]]
            yield self._weights[tap], np.where(((rows >= 0) & (rows < height))[:, None, None], there, 0)


convolution = Convolution
