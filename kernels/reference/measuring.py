"""Quantiles, and differences in windows that noise alone would make: NumPy, float64, as `Measuring` defines them."""

import math

import numpy as np

from lfgpu.contract import GRAIN_WINDOW, Float64Array as Array

FOURTH_DIFFERENCE = (1, -4, 6, -4, 1)


def quantile(
    values: Array, share: float, *, quantile_out: Array, among: Array | None = None, least: Array | None = None
) -> None:
    counts = ~np.isnan(values)
    if among is not None and least is not None:
        counts &= among >= least[0]
    quantile_out[0] = np.quantile(values[counts], share) if counts.any() else np.nan


def window_grain(
    image: Array, limits: Array, *, least: float, differences_out: Array, limited_out: Array, grain_out: Array
) -> None:
    weights = np.outer(FOURTH_DIFFERENCE, FOURTH_DIFFERENCE)
    side = len(FOURTH_DIFFERENCE)
    around = np.lib.stride_tricks.sliding_window_view(image, (side, side), (0, 1))
    unit = math.sqrt(math.pi / 2) / np.square(FOURTH_DIFFERENCE).sum()
    differences_out[:] = unit * np.abs((around * weights).sum((3, 4))).mean(2)
    limited_out[:] = ((around == limits[0, :, None, None]) | (around == limits[1, :, None, None])).any((2, 3, 4))

    def windows(values: Array) -> Array:
        padded = np.pad(values, GRAIN_WINDOW // 2, mode="symmetric")
        return np.lib.stride_tricks.sliding_window_view(padded, (GRAIN_WINDOW, GRAIN_WINDOW))

    means = windows(differences_out).mean((2, 3))
    grain_out[:] = np.where((means <= least) & (windows(limited_out) > 0).any((2, 3)), np.nan, means)
