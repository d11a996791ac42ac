"""Convolutions of volumes; `kernels/reference/convolution.py` says what they are."""

from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import Convolution, Float32Array

from .memory import pixel_type, start
from .native_code import kernel
from .threads import c_type, in_slices, launch, load, once, with_wide_vectors

_LANES = 16  # channels of the output that a CPU computes side by side

_Strides = tuple[int, int, int]


@once
def _rows_kernel(shape: tuple[int, ...], strides: _Strides, rectified: bool, stored: Any, result: Any) -> Any:
    """Return the kernel for weights of a shape [l, y, x, c_in, c_out]."""
    *_, inputs, outputs = shape
    numbers: dict[str, Any] = dict(
        zip(("KL", "KY", "KX", "CI", "CO", "SL", "SY", "SX"), (*shape, *strides), strict=True)
    )
    numbers |= {
        "PADDED": _padded(outputs),
        "RECTIFIED": int(rectified),
        "STORED": c_type(stored),
        "RESULT": c_type(result),
    }
    types = {"In": pixel_type(inputs, stored), "Added": pixel_type(outputs, stored), "Out": pixel_type(outputs, result)}
    module = (
        f"lfgpu_convolution_{'_'.join(map(str, (*shape, *strides)))}_{rectified:d}_{stored.__name__}_{result.__name__}"
    )
    return with_wide_vectors(kernel("convolution.h", "convolve_rows", module=module, **types, **numbers))


def _padded(channels: int) -> int:
    return -(-channels // _LANES) * _LANES


class _Convolution:
    """The weights in the order in which a device reads them."""

    def __init__(
        self, weights: Float32Array, bias: Float32Array, device: str, strides: _Strides, rectified: bool
    ) -> None:
        self._shape, self._strides, self._rectified = weights.shape, strides, rectified
        self._device = wp.get_device(device)
        more = _padded(len(bias)) - len(bias)
        self._weights = self._kept(np.pad(weights, [(0, 0)] * 4 + [(0, more)]))
        self._bias = self._kept(np.pad(bias, (0, more)))

    def _kept(self, values: Float32Array) -> Any:
        return wp.array(values.reshape(-1), dtype=float, device=self._device)

    def __call__(self, volume: Any, added: Any, volume_out: Any, *, at: int = 0) -> None:
        labels = -(-volume.shape[0] // self._strides[0])
        out = volume_out[at : at + labels]
        stored, result = (array.dtype._wp_scalar_type_ for array in (volume, out))
        convolve = _rows_kernel(self._shape, self._strides, self._rectified, stored, result)
        load(self._device, convolve)

        def some_rows(_: int, first: int, last: int) -> None:
            launch(convolve, 1, [volume, self._weights, self._bias, added, first, last], [out], device="cpu")

        in_slices(self._device, labels * out.shape[1], some_rows)


def convolution(
    weights: Float32Array, bias: Float32Array, device: str, *, strides: _Strides = (1, 1, 1), rectified: bool = False
) -> Convolution:
    start()
    return _Convolution(weights, bias, device, strides, rectified)
