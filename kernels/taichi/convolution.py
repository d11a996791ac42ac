"""Convolutions of volumes; `kernels/reference/convolution.py` says what they are."""

import math
from typing import Any

import taichi as ti

from lfgpu.contract import Float32Array, Rows

from .memory import DeviceArray, field, flat
from .runtime import once, run

_MOST = 8  # channels of the output that a thread computes


@once
def _kernel(stored: Any, result: Any, adds: bool, rectified: bool, together: int) -> Any:
    """Return the kernel whose threads compute so many channels of the output each."""
    volumes = flat(stored)

    @ti.kernel
    def convolve_kernel(
        volume: volumes,
        weights: flat(),
        bias: flat(),
        added: volumes,
        labels: int,
        held: int,
        width: int,
        inputs: int,
        outputs: int,
        kernel_l: int,
        kernel_y: int,
        kernel_x: int,
        stride_l: int,
        stride_y: int,
        stride_x: int,
        more_labels: int,
        more_rows: int,
        more_columns: int,
        first: int,
        rows: int,
        height: int,
        high: int,
        held_out: int,
        volume_out: flat(result),
    ):
        slices = (labels + stride_l - 1) // stride_l
        columns = (width + stride_x - 1) // stride_x
        groups = outputs // together
        for i in range(slices * rows * columns * groups):
            c = i % groups * together
            x = i // groups % columns
            y = first + i // groups // columns % rows
            slice_ = i // groups // columns // rows
            sums = ti.Vector([0.0 for _ in range(together)])
            for k in range(kernel_l * kernel_y * kernel_x):
                tl = slice_ * stride_l + k // kernel_x // kernel_y - kernel_l // 2
                ty = y * stride_y + k // kernel_x % kernel_y - kernel_y // 2
                tx = x * stride_x + k % kernel_x - kernel_x // 2
                if tl >= 0 and tl < labels and ty >= 0 and ty < height and tx >= 0 and tx < width:
                    there = ((tl * held + ty % held) * width + tx) * inputs
                    weight = k * inputs * outputs + c
                    for j in range(inputs):
                        value = ti.cast(volume[there + j], ti.f32)
                        for g in ti.static(range(together)):
                            sums[g] += weights[weight + j * outputs + g] * value
            more = slice_ * more_labels // slices * more_rows + y // high % more_rows
            more = (more * more_columns + x * more_columns // columns) * outputs + c
            here = ((slice_ * held_out + y % held_out) * columns + x) * outputs + c
            for g in ti.static(range(together)):
                value = sums[g] + bias[c + g]
                if ti.static(adds):
                    value += ti.cast(added[more + g], ti.f32)
                if ti.static(rectified):
                    value = ti.max(value, 0.0)
                volume_out[here + g] = ti.cast(value, result)

    return convolve_kernel


class convolution:
    """The weights on the device."""

    def __init__(
        self,
        weights: Float32Array,
        bias: Float32Array,
        device: str,
        *,
        strides: tuple[int, int, int] = (1, 1, 1),
        rectified: bool = False,
    ) -> None:
        self._weights, self._bias = field(weights, device), field(bias, device)
        self._strides, self._rectified = strides, rectified

    def __call__(
        self, volume: DeviceArray, added: DeviceArray | None, volume_out: DeviceArray, *, rows: Rows | None = None
    ) -> None:
        window, (inputs, outputs) = self._weights.shape[:3], self._weights.shape[3:]
        convolve = _kernel(
            volume.scalar, volume_out.scalar, added is not None, self._rectified, math.gcd(outputs, _MOST)
        )
        more = volume if added is None else added
        sizes = *volume.shape, inputs, outputs, *window, *self._strides, *more.shape
        held, columns = volume_out.shape[1:]
        if rows is None:
            place = 0, held, volume.shape[1], 1 if added is None else held // added.shape[1]
        else:
            high = 1 if added is None else columns // added.shape[2]
            place = rows.first, rows.last - rows.first, rows.all * self._strides[1], high
        run(convolve, volume, self._weights, self._bias, more, *sizes, *place, held, volume_out)
