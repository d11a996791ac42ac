"""Convolutions of volumes: NumPy, float64, tap by tap."""

from collections.abc import Iterator

import numpy as np

from lfgpu.contract import Float32Array, Float64Array as Array, Rows


class convolution:
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
        if rows is not None:  # those that are not there are of no use to these
            volume = volume[:, np.arange(rows.all * self._strides[1]) % volume.shape[1]]
        size = [-(-length // stride) for length, stride in zip(volume.shape, self._strides, strict=False)]
        sums = np.zeros((*size, 1)) + self._bias
        for weights, shifted in self._taps(volume):
            sums += shifted @ weights
        if added is not None:
            if rows is not None:
                added = added[:, np.arange(size[1] * added.shape[2] // size[2]) % added.shape[1]]
            for axis in range(3):
                added = added.repeat(size[axis] // added.shape[axis], axis)
            sums += added
        lines = np.arange(size[1]) if rows is None else np.arange(rows.first, rows.last)
        found = np.maximum(sums, 0) if self._rectified else sums
        volume_out[:, lines % volume_out.shape[1]] = found[:, lines]

    def _taps(self, volume: Array) -> Iterator[tuple[Array, Array]]:
        """Yield weights [c_in, c_out] and what they are for, [l, y, x, c_in]."""
        sizes = self._weights.shape[:3]
        padded = np.pad(volume, [*((size // 2, size // 2) for size in sizes), (0, 0)])
        for tap in np.ndindex(sizes):
            lengths = zip(tap, volume.shape, self._strides, strict=False)
            yield self._weights[tap], padded[tuple(slice(k, k + length, stride) for k, length, stride in lengths)]
