"""Quantiles, and differences in windows that noise alone would make; `Measuring` in `lfgpu/contract` says how."""

import math
from typing import Any

import numpy as np

from lfgpu.contract import GRAIN_WINDOW

from .memory import pixel_type
from .native_code import kernel
from .threads import flat, launch, launch_rows

_UNIT = math.sqrt(math.pi / 2) / 70  # squares of 1, -4, 6, -4, 1
_BLOCK = 64  # columns that a CPU works on at a time
_THREADS = 1024  # that find a quantile on a GPU


def _quantile_kernel() -> Any:
    return kernel("measuring.cuh", "find_quantile", launch_bounds=(_THREADS, 1), BLOCK=_THREADS)


def _kernel(name: str, channels: int, block: int) -> Any:
    numbers = {"CHANNELS": channels, "WINDOW": GRAIN_WINDOW, "BLOCK": block}
    return kernel("measuring.h", name, Pixel=pixel_type(channels), **numbers)


def quantile(values: Any, share: float, *, quantile_out: Any, among: Any = None, least: Any = None) -> None:
    if not values.device.is_cpu:
        inputs = [flat(values), None if among is None else flat(among), least, share]
        launch(_quantile_kernel(), _THREADS, inputs, [quantile_out], device=values.device, block_dim=_THREADS)
        return
    there = values.numpy()
    counts = ~np.isnan(there)
    if among is not None:
        counts &= among.numpy() >= np.float32(least.numpy()[0])
    quantile_out.numpy()[0] = np.quantile(there[counts], share) if counts.any() else np.nan


def window_grain(
    image: Any, limits: Any, *, least: float, differences_out: Any, limited_out: Any, grain_out: Any
) -> None:
    kind = image.dtype._length_, _BLOCK if image.device.is_cpu else 1
    launch_rows(_kernel("find_differences", *kind), [image, limits, _UNIT], differences_out, limited_out)
    launch_rows(_kernel("find_grain", *kind), [differences_out, limited_out, least], grain_out)
