"""Quantiles, and differences in windows that noise alone would make; `Measuring` in `lfgpu/contract` says how."""

import math
from typing import Any

import taichi as ti

from lfgpu.contract import GRAIN_WINDOW

from .memory import DeviceArray, empty, flat, one, optional
from .runtime import double, once, run

_UNIT = math.sqrt(math.pi / 2) / 70  # squares of 1, -4, 6, -4, 1
_BITS = 8  # of a value that are looked at together


@ti.func
def _key(value: float):
    """Return an unsigned number; these are in the order of the values."""
    bits = ti.bit_cast(value, ti.u32)
    return ti.select(bits >> 31 == 1, ~bits, bits | ti.u32(0x80000000))


@ti.func
def _value(key: ti.u32):
    return ti.bit_cast(ti.select(key >> 31 == 1, key & ti.u32(0x7FFFFFFF), ~key), ti.f32)


@once
def _quantile_kernel(chosen: bool) -> Any:
    real = double()

    @ti.func
    def counts_in(values: ti.template(), among: ti.template(), least: ti.template(), i: int):
        counts = values[i] == values[i]
        if ti.static(chosen):
            counts = counts and among[i] >= ti.cast(least[0], ti.f32)
        return counts

    @ti.kernel
    def quantile_kernel(
        values: flat(),
        among: flat(),
        least: flat(real),
        share: real,
        counts: flat(ti.i32),
        keys: flat(ti.u32),
        quantile_out: flat(real),
    ):
        """`counts` are those of the values by some bits, of what lies below those that stay, and of all.

        `keys` are the bits of those that stay, and the key of the least value above them.
        """
        for shift in ti.static(range(32 - _BITS, -1, -_BITS)):
            for k in range(2**_BITS + 2):
                if k < 2**_BITS or shift == 32 - _BITS:
                    counts[k] = 0
                if k < 2 and shift == 32 - _BITS:
                    keys[k] = ti.cast(-k, ti.u32)
            for i in range(values.shape[0]):
                key = _key(values[i])
                stays = True
                if ti.static(shift < 32 - _BITS):
                    stays = key >> (shift + _BITS) == keys[0] >> (shift + _BITS)
                if stays and counts_in(values, among, least, i):
                    ti.atomic_add(counts[ti.cast(key >> shift & 255, ti.i32)], 1)
            for _ in range(1):
                if ti.static(shift == 32 - _BITS):
                    total = 0
                    for k in range(2**_BITS):
                        total += counts[k]
                    counts[2**_BITS + 1] = total
                place = ti.cast(share * (counts[2**_BITS + 1] - 1), ti.i32)
                first = counts[2**_BITS]
                k = 0
                while k < 2**_BITS - 1 and first + counts[k] <= place:
                    first += counts[k]
                    k += 1
                counts[2**_BITS] = first
                keys[0] = keys[0] | (ti.cast(k, ti.u32) << shift)
        for i in range(values.shape[0]):
            key = _key(values[i])
            if key > keys[0] and counts_in(values, among, least, i):
                ti.atomic_min(keys[1], key)
        for _ in range(1):
            total = counts[2**_BITS + 1]
            place = share * (total - 1)
            whole = ti.cast(place, ti.i32)
            low = ti.cast(_value(keys[0]), real)
            high = low
            if whole + 1 >= counts[2**_BITS] + counts[ti.cast(keys[0] & 255, ti.i32)] and whole + 1 < total:
                high = ti.cast(_value(keys[1]), real)
            found = ti.cast(low + (place - whole) * (high - low), ti.f32)
            quantile_out[0] = ti.cast(ti.select(total > 0, found, ti.math.nan), real)

    return quantile_kernel


@once
def _room() -> tuple[DeviceArray, DeviceArray]:
    return empty((2**_BITS + 2,), scalar=ti.i32), empty((2,), scalar=ti.u32)


def quantile(
    values: DeviceArray,
    share: float,
    *,
    quantile_out: DeviceArray,
    among: DeviceArray | None = None,
    least: DeviceArray | None = None,
) -> None:
    (chosen, is_chosen), limit = optional(among), one() if least is None else least
    run(_quantile_kernel(is_chosen), values, chosen, limit, share, *_room(), quantile_out)


@once
def _differences_kernel(channels: int) -> Any:
    @ti.kernel
    def differences_kernel(
        image: flat(ti.f32, channels),
        limits: flat(),
        height: int,
        width: int,
        differences_out: flat(),
        limited_out: flat(),
    ):
        for p in range(height * width):
            at = p // width * (width + 4) + p % width
            total = 0.0
            limited = 0.0
            for c in ti.static(range(channels)):
                difference = 0.0
                for i, j in ti.ndrange(5, 5):
                    value = image[at + i * (width + 4) + j][c]
                    difference += _weight(i) * _weight(j) * value
                    if value == limits[c] or value == limits[channels + c]:
                        limited = 1.0
                total += ti.abs(difference)
            differences_out[p] = total / channels * _UNIT
            limited_out[p] = limited

    return differences_kernel


@ti.func
def _weight(k: int):
    return ti.select(k == 2, 6.0, ti.select(k % 2 == 1, -4.0, 1.0))


@ti.func
def _mirrored(k: int, size: int):
    return ti.select(k < 0, -1 - k, ti.select(k < size, k, 2 * size - 1 - k))


@ti.kernel
def _grain_kernel(differences: flat(), limited: flat(), height: int, width: int, least: float, grain_out: flat()):
    for p in range(height * width):
        total = 0.0
        is_limited = False
        for i, j in ti.ndrange(GRAIN_WINDOW, GRAIN_WINDOW):
            y = _mirrored(p // width + i - GRAIN_WINDOW // 2, height)
            x = _mirrored(p % width + j - GRAIN_WINDOW // 2, width)
            total += differences[y * width + x]
            is_limited = is_limited or limited[y * width + x] > 0.0
        mean = total / GRAIN_WINDOW**2
        if mean <= least and is_limited:
            mean = ti.math.nan
        grain_out[p] = mean


def window_grain(
    image: DeviceArray,
    limits: DeviceArray,
    *,
    least: float,
    differences_out: DeviceArray,
    limited_out: DeviceArray,
    grain_out: DeviceArray,
) -> None:
    size = grain_out.shape
    run(_differences_kernel(image.channels or 1), image, limits, *size, differences_out, limited_out)
    run(_grain_kernel, differences_out, limited_out, *size, least, grain_out)
