"""Views compared at a low resolution, to find which disparities there are: NumPy, float64, view by view.

`RangeSearch` in `lfgpu/contract` says what is computed.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import UNSEEN, Details, Disparities, Float64Array as Array, SideCosts, sweep_shifts

from .cost_volume import parabola_vertex
from .nlm import box_sum
from .plane_sweep import bilinear, shifted

LEAST_SHARE = 0.5  # of the terms of a side that must have a part


def window_sums(values: Array, window: int) -> Array:
    """Compute the sum of [y, x] over the window around each pixel, border pixels repeated."""
    padded = np.pad(values, window // 2, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, (window, window)).sum((2, 3)))


def blocks(values: NDArray[Any], factor: int) -> NDArray[Any]:
    """[y, x] or [y, x, c] as [y / factor, factor, x / factor, factor, c]."""
    height, width = values.shape[0] // factor, values.shape[1] // factor
    return values[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)


def shrink(
    views: Array, chosen: Sequence[int], valid: Array | None, *, scale: float, factor: int, images_out: Array
) -> None:
    for k, index in enumerate(chosen):
        images_out[k] = scale * blocks(views[index], factor).mean((1, 3, 4))
        if valid is not None:
            images_out[k][(blocks(valid[k], factor) == 0).any((1, 3, 4))] = np.nan


def details(shape: Sequence[int], device: str, *, factor: int, window: int) -> Details:
    def evaluate(images: Array, details_out: Array) -> None:
        for image, detail_out in zip(images, details_out, strict=True):
            smaller = blocks(image, factor).mean((1, 3, 4))
            known = ~np.isnan(smaller)
            share = window_sums(known.astype(np.float64), window)
            detail_out[:] = smaller - window_sums(np.where(known, smaller, 0), window) / np.maximum(share, 1)

    return evaluate


def differences(detail: Array, image: Array, shift: Array) -> Array:
    """|D_n(q - d o_n) - D_r(q)| at each pixel q, NaN where it has no part."""
    x, y = shifted(image.shape[1], shift[0]), shifted(image.shape[0], shift[1])
    unknown = np.isnan(detail)
    seen = bilinear(np.where(unknown, 0, detail)[..., None], x, y)[..., 0]
    needed = bilinear(unknown.astype(np.float64)[..., None], x, y)[..., 0] > 0
    return np.where(np.outer(y.inside, x.inside) & ~needed, np.abs(seen - image), np.nan)


def side_costs(
    shape: Sequence[int],
    offsets: NDArray[Any],
    lines: Sequence[Sequence[Sequence[int]]],
    device: str,
    *,
    reference: int,
    count: int,
) -> SideCosts:
    def cost(details: Array, shifts: Array, side: Sequence[int]) -> Array:
        found = np.stack([differences(details[n], details[reference], shifts[n]) for n in side])
        parts = box_sum((~np.isnan(found)).sum(0).astype(np.float64), 1)
        total = box_sum(np.nansum(found, 0), 1)
        return np.where(parts >= LEAST_SHARE * 9 * len(side), total / np.maximum(parts, 1), UNSEEN)

    def evaluate(details: Array, first: float, step: float, volume_out: Array) -> None:
        shifts = sweep_shifts(offsets, Disparities(first, step, count))
        for line, costs_out in zip(lines, volume_out, strict=True):
            for label in range(count):
                costs_out[label] = np.min([cost(details, shifts[label], side) for side in line], axis=0)

    return evaluate


def distinct_minimum(volume: Array, *, apart: int, found_out: Sequence[Array]) -> None:
    place_out, least_out, spread_out, others_out, worst_out = found_out
    costs = np.minimum(volume, 1).mean(0)
    labels = np.arange(len(costs))[:, None, None]
    k = costs.argmin(0)

    def at(values: Array, label: NDArray[np.int64]) -> Array:
        return np.take_along_axis(values, label[None], 0)[0]

    inner = k.clip(1, len(costs) - 2)
    least, before, after = at(costs, k), at(costs, inner - 1), at(costs, inner + 1)
    place_out[:] = k + np.where(k == inner, parabola_vertex(before, least, after), 0.0)
    least_out[:] = least
    spread_out[:] = np.where(least < 1, costs.max(0) - least, np.nan)
    others = np.where(np.abs(labels - k) > apart, costs, np.inf).min(0)
    others_out[:] = np.where(np.isfinite(others), others - least, UNSEEN)
    worst_out[:] = np.where(k == inner, np.max([at(line, k) for line in volume], axis=0), UNSEEN)


def agreeing_disparity(
    found: Sequence[Array],
    noise: Array,
    *,
    least_noise: float,
    same: float,
    other: float,
    neighbors: int,
    first: float,
    step: float,
    disparity_out: Array,
) -> None:
    place, _, _, others, worst = found
    s = np.fmax(noise[0], least_noise)
    sure = (worst <= min(same * s, 1)) & (others >= other * s)
    disparity = np.where(sure, first + step * place, np.nan)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(disparity, 1, constant_values=np.nan), (3, 3))
    alike = np.abs(around - disparity[..., None, None]) <= 1.5 * step
    count = alike.sum((2, 3))
    mean = np.where(alike, around, 0).sum((2, 3)) / np.maximum(count, 1)
    disparity_out[:] = np.where(count > neighbors, mean, np.nan)
