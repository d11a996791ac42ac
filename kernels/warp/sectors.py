"""Costs by angular sector; `kernels/reference/sectors.py` says what they are."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import COST_UNIT, COSTS, FOLD, SECTORS, Rows, sectors_of

from .cpu_plane_sweep import kept_type, loading_kernels
from .gpu_plane_sweep import WARP, kept_type as gpu_kept_type, pack_kernel
from .memory import pixel_type
from .native_code import c_type, kernel, names_of
from .threads import check_size, flat, launch, launch_slices, once
from .vector import dot

_MORE = 17  # columns of views that nothing reads: rows of all views would share few places of a cache
_CHUNK = 128  # columns whose costs stay in a cache
_NUMBERS: dict[str, Any] = {"SECTORS": SECTORS, "FOLD": FOLD, "UNIT": COST_UNIT}
_BLOCK, _HIGH = 128, 2  # threads of a GPU, and the folded rows in which each has pixels


def _costs_kernel(channels: int, stored: Any, costs: Any) -> Any:
    numbers = {**_NUMBERS, "CHANNELS": channels, "CHUNK": _CHUNK, "STORED": c_type(costs, for_vectors=True)}
    types = {"Kept": kept_type(stored), "Pixel": pixel_type(channels), "Costs": pixel_type(FOLD**2 * COSTS, costs)}
    return kernel("sectors.h", "find_sector_costs", **types, **numbers)


def _gpu_costs_kernel(channels: int, stored: Any, costs: Any, masked: bool) -> Any:
    kept = gpu_kept_type(channels, stored)
    numbers: dict[str, Any] = {**_NUMBERS, "CHANNELS": channels, "BLOCK": _BLOCK, "HIGH": _HIGH, "MASKED": masked}
    types = {"Kept": kept, "Pixel": pixel_type(channels), "Costs": pixel_type(FOLD**2 * COSTS, costs)}
    numbers |= {"STORED": c_type(costs), "BYTES": {wp.uint8: 1, wp.uint16: 2}.get(stored, 0), **names_of(kept)}
    return kernel("sectors.cuh", "find_sector_costs", **types, **numbers)


class sector_costs:
    """The views by sector, and as the device reads them."""

    def __init__(self, shape: Sequence[int], offsets: Any, *, scale: float) -> None:
        self._shape, self._device, self._scale = tuple(shape), offsets.device, scale
        places = offsets.numpy()
        sectors = sectors_of(places)
        order = np.argsort(sectors, kind="stable")[np.count_nonzero(sectors < 0) :]
        begins = np.searchsorted(sectors[order], np.arange(SECTORS + 1))
        self._order, self._begins = (
            wp.array(numbers.astype(np.int32), dtype=int, device=self._device) for numbers in (order, begins)
        )
        self._offsets = wp.array(places[order], dtype=wp.vec2f, device=self._device)
        self._stored: Any = None

    def load(self, image: Any, recorded: Any, valid: Any) -> None:
        n, height, width, channels = self._shape
        stored = recorded.dtype._wp_scalar_type_
        if stored is not self._stored:
            self._stored = stored
            if self._device.is_cpu:
                self._views = wp.empty((n, channels, height, width + _MORE), dtype=kept_type(stored), device="cpu")
            else:
                self._views = wp.empty((n, height, width), dtype=gpu_kept_type(channels, stored), device=self._device)
        self._image, self._valid = image, valid
        if not self._device.is_cpu:
            inputs = [flat(recorded), None if valid is None else flat(valid)]
            launch(pack_kernel(channels, stored), recorded.size, inputs, [flat(self._views)], device=self._device)
            return
        launch_slices(loading_kernels(channels, stored).views, len(recorded), [recorded, 0], self._views)

    def __call__(self, first: Any, factor: Any, costs_out: Any, *, step: float, rows: Rows | None = None) -> None:
        kind = self._shape[-1], self._stored, costs_out.dtype._wp_scalar_type_
        labels, held, columns = costs_out.shape
        top, some = (0, held) if rows is None else (rows.first, rows.last - rows.first)
        planned = [self._order, self._begins, self._offsets, first, factor, self._scale, step, top]
        if not self._device.is_cpu:
            strips = -(-some // _HIGH) * -(-columns * FOLD // WARP)
            threads = -(-labels * WARP // _BLOCK) * _BLOCK * strips
            check_size(threads)
            inputs = [self._views, self._image, *planned, some]
            costs = _gpu_costs_kernel(*kind, self._valid is not None)
            launch(costs, threads, inputs, [costs_out], device=self._device, block_dim=_BLOCK)
            return
        inputs = [self._views, self._image, self._valid, *planned]
        launch_slices(_costs_kernel(*kind), labels * some, inputs, costs_out)


@wp.kernel(module="lfgpu_brightness", enable_backward=False)
def _factor_kernel(count: wp.float64, factor: wp.array(dtype=wp.float64)):
    """Turn the sum of `count` intensities into the factor for their mean."""
    mean = factor[0] / count
    factor[0] = wp.clamp(wp.float64(0.4) / (mean + wp.float64(0.08)), wp.float64(0.5), wp.float64(4.0))


def brightness(image: Any, *, factor_out: Any) -> None:
    count = image.size * image.dtype._length_
    if not hasattr(factor_out, "lfgpu_ones"):  # made once, as captured work must not allocate
        factor_out.lfgpu_ones = wp.full(count, 1.0, dtype=float, device=image.device)
    values = wp.array(ptr=image.ptr, dtype=float, shape=count, device=image.device, copy=False)
    dot(values, factor_out.lfgpu_ones, factor_out)
    launch(_factor_kernel, 1, [count], [factor_out], device=image.device)


@once
def _fold_kernel(channels: int, stored: Any) -> Any:
    pixel, folded = pixel_type(channels), pixel_type(4 * FOLD**2, stored)

    @wp.kernel(module=f"lfgpu_fold_{channels}_{stored.__name__}", enable_backward=False)
    def fold_kernel(
        image: wp.array2d(dtype=pixel), factor: wp.array(dtype=wp.float64), folded_out: wp.array3d(dtype=folded)
    ):
        y, x = wp.tid()
        gain = float(factor[0])
        result = folded()
        for i in range(wp.static(FOLD)):
            for j in range(wp.static(FOLD)):
                row = wp.min(wp.static(FOLD) * y + i, image.shape[0] - 1)
                color = image[row, wp.min(wp.static(FOLD) * x + j, image.shape[1] - 1)]
                for c in range(3):
                    value = gain * color[wp.min(c, wp.static(channels - 1))]
                    result[wp.static(FOLD**2) * c + wp.static(FOLD) * i + j] = stored(value)
        folded_out[0, y, x] = result

    return fold_kernel


def fold(image: Any, factor: Any, *, folded_out: Any) -> None:
    folding = _fold_kernel(image.dtype._length_, folded_out.dtype._wp_scalar_type_)
    launch(folding, folded_out.shape[1:], [image, factor], [folded_out], device=image.device)
