"""Costs by angular sector: NumPy, float64, view by view. `SectorCosts` in `lfgpu/contract` says what is computed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import COST_UNIT, COSTS, FOLD, SECTORS, Float64Array as Array, Rows, sectors_of


def folded(image: Array, folded_out: Array) -> None:
    """Fold an image [y, x, c] into [y', x', FOLD^2 c]."""
    height, width, channels = folded_out.shape
    more = [(0, FOLD * side - there) for side, there in zip((height, width), image.shape, strict=False)]
    whole = np.pad(image, [*more, (0, 0)], mode="edge").reshape(height, FOLD, width, FOLD, image.shape[2])
    folded_out[:] = whole.transpose(0, 2, 4, 1, 3).reshape(height, width, channels)


def growth(difference: Array) -> Array:
    return np.log1p(difference / COST_UNIT) / 4


class sector_costs:
    """The costs of views of one light field."""

    def __init__(self, shape: Sequence[int], offsets: Array, *, scale: float) -> None:
        self._offsets, self._sectors, self._scale = offsets.copy(), sectors_of(offsets), scale

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid

    def __call__(self, first: Array, factor: Array, costs_out: Array, *, step: float, rows: Rows | None = None) -> None:
        _, held, *others = costs_out.shape
        lines = np.arange(held) if rows is None else np.arange(rows.first, rows.last)
        for k, slice_out in enumerate(costs_out):
            whole = np.empty((held if rows is None else rows.all, *others))
            folded(self._costs(first + k * step, factor[0]), whole)
            slice_out[lines % held] = whole[lines]

    def _costs(self, disparity: Array, factor: float) -> Array:
        """Compute the costs [y, x, COSTS] at a map."""
        costs = np.full((COSTS, *disparity.shape), np.nan)
        for sector in range(SECTORS):
            single, common = np.zeros(disparity.shape), np.zeros(self._image.shape)
            count = np.zeros(disparity.shape)
            for n in np.flatnonzero(self._sectors == sector):
                view, inside = self._view(int(n), disparity)
                difference = np.where(inside[..., None], factor * (self._scale * view - self._image), 0)
                single += np.abs(difference).mean(2)
                common += difference
                count += inside
            there = count > 0
            costs[sector, there] = growth(single[there] / count[there])
            costs[SECTORS + sector, there] = growth(np.abs(common[there]).mean(1) / count[there])
        for some in (costs[:SECTORS], costs[SECTORS:]):
            there = np.isfinite(some)
            count = there.sum(0)
            mean = np.where(count > 0, np.where(there, some, 0).sum(0) / np.maximum(count, 1), 1)
            some[:] = np.where(there, some, mean)
        return costs.transpose(1, 2, 0)

    def _view(self, n: int, disparity: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Look up a view [y, x, c] at a map, and where it takes part."""
        height, width = disparity.shape
        y, x = np.mgrid[:height, :width] - disparity * self._offsets[n, ::-1, None, None]
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        x, y = x.clip(0, width - 1), y.clip(0, height - 1)
        if self._valid is not None:
            inside &= self._valid[n][np.floor(y + 0.5).astype(int), np.floor(x + 0.5).astype(int)] != 0
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
        a, b, view = (x - x0)[..., None], (y - y0)[..., None], self._recorded[n]
        upper = view[y0, x0] + a * (view[y0, x1] - view[y0, x0])
        lower = view[y1, x0] + a * (view[y1, x1] - view[y1, x0])
        return upper + b * (lower - upper), inside


def brightness(image: Array, *, factor_out: Array) -> None:
    factor_out[:] = (0.4 / (image.mean() + 0.08)).clip(0.5, 4)


def fold(image: Array, factor: Array, *, folded_out: Array) -> None:
    colours = np.broadcast_to(image, (*image.shape[:2], 3))
    folded(factor[0] * np.pad(colours, [(0, 0), (0, 0), (0, 1)]), folded_out[0])
