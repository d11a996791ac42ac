"""Matching costs of the views at a row of disparities: NumPy, float64, view by view.

`PlaneSweep` in `lfgpu/contract` says what is computed. Truncated absolute differences are robust against what is hidden
or shines (Scharstein and Szeliski 2002); those of gradients bear differences in brightness. Roots of differences make
faint texture count beside strong edges.
"""

from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Disparities, Float64Array as Array, SweepCost, ViewSets, sweep_shifts

from .nlm import central_differences

LEAST_OFFSET = 1e-3  # view steps; what is nearer to the reference view is the reference view
PENALTY = 1e-4  # of all view_sets but the first, besides their preference


class Compared(NamedTuple):
    """One view at one disparity, [y, x] each."""

    view: int
    cost: Array
    inside: NDArray[np.bool_]  # it takes part
    nearest: tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and columns of the nearest pixels in the view


class Axis(NamedTuple):
    """The sources of the pixels along one axis when they are shifted."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    share: Array  # of the second
    inside: NDArray[np.bool_]
    nearest: NDArray[np.int64]


def shifted(size: int, shift: float) -> Axis:
    place = np.arange(size) + shift
    moved = place.clip(0, size - 1)
    first = np.floor(moved).astype(np.int64)
    nearest = np.floor(moved + 0.5).astype(np.int64)
    second = np.minimum(first + 1, size - 1)
    return Axis(first, second, moved - first, (place >= 0) & (place <= size - 1), nearest)


def bilinear(view: Array, x: Axis, y: Axis) -> Array:
    """Compute the view [y, x, c] at all shifted pixels."""
    rows = view[y.first] + y.share[:, None, None] * (view[y.second] - view[y.first])
    return rows[:, x.first] + x.share[:, None] * (rows[:, x.second] - rows[:, x.first])


def rooted(difference: Array | float, softness: float) -> Array | float:
    """Keep a difference while it is small; beyond the softness take its root."""
    return 2 * softness * (np.sqrt(1 + difference / softness) - 1) if softness > 0 else difference


def most(cost: SweepCost) -> float:
    """Compute the largest cost."""
    gradients = cost.gradient_weight * cost.gradient_truncation
    return float((rooted(cost.truncation, cost.softness) + gradients) / (1 + cost.gradient_weight))


class plane_sweep:
    """The sweep over views of one light field."""

    def __init__(
        self,
        shape: Sequence[int],
        views: ViewSets,
        disparities: Disparities,
        *,
        scale: float,
        shared: Any = None,
    ) -> None:
        offsets = views.offsets
        self._view_sets = views.members != 0
        self._disparities = disparities.first + disparities.step * np.arange(disparities.count)
        self._shifts = sweep_shifts(offsets, disparities)
        self._others = np.flatnonzero(np.hypot(*offsets.T) > LEAST_OFFSET)
        self._scale, self._loaded = scale, SimpleNamespace() if shared is None else shared._loaded
        self._preference, self._tolerance, self._least = views.preference, views.tolerance, views.least

    def room(self, stored: Any) -> int:
        return 0

    def load(self, image: Array, recorded: Array, valid: Array | None, room: Any = None) -> None:
        self._loaded.image, self._loaded.recorded, self._loaded.valid = image, recorded.copy(), valid

    def by_view_sets(self, cost: SweepCost, volume_out: Array) -> None:
        size = (len(self._view_sets), *self._loaded.image.shape[:2])
        for label, slice_out in enumerate(volume_out):
            sums, counts = np.zeros(size), np.zeros(size)
            for compared in self._compared(label, cost):
                members = self._view_sets[:, compared.view]
                sums[members] += np.where(compared.inside, compared.cost, 0)
                counts[members] += compared.inside
            means = np.where(counts > 0, sums / np.maximum(counts, 1), most(cost))
            means[1:] = means[1:] * (1 + self._preference) + PENALTY
            slice_out[:] = means.min(0)

    def by_visibility(self, nearest: Array, cost: SweepCost, volume_out: Array) -> None:
        for label, slice_out in enumerate(volume_out):
            total, count = np.zeros(slice_out.shape), np.zeros(slice_out.shape)
            for compared in self._compared(label, cost):
                surface = nearest[compared.view][compared.nearest]
                sees = compared.inside & (self._disparities[label] >= surface - self._tolerance)
                total += np.where(sees, compared.cost, 0)
                count += sees
            slice_out[:] = np.where(count >= self._least, total / np.maximum(count, 1), most(cost))

    def _compared(self, label: int, cost: SweepCost) -> Iterator[Compared]:
        """Yield each view but the reference."""
        image, recorded, valid = self._loaded.image, self._loaded.recorded, self._loaded.valid
        height, width, _ = image.shape
        for n in self._others:
            x, y = shifted(width, self._shifts[label, n, 0]), shifted(height, self._shifts[label, n, 1])
            difference = self._scale * bilinear(recorded[n], x, y) - image
            color = np.abs(difference).mean(2)
            gradient = np.abs(np.concatenate(central_differences(difference), axis=2)).mean(2)
            robust = rooted(np.minimum(color, cost.truncation), cost.softness)
            robust += cost.gradient_weight * np.minimum(gradient, cost.gradient_truncation)
            inside, nearest = np.outer(y.inside, x.inside), tuple(np.meshgrid(y.nearest, x.nearest, indexing="ij"))
            if valid is not None:
                inside &= valid[n][nearest] != 0
            yield Compared(int(n), robust / (1 + cost.gradient_weight), inside, (nearest[0], nearest[1]))
