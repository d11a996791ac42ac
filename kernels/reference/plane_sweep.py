"""How well the views agree with the reference view at each of a row of disparities: NumPy, float64, view by view.

`PlaneSweep` in `lfgpu/contract` says what is computed. Truncated absolute differences are robust against what is hidden
or shines (Scharstein and Szeliski 2002); those of gradients bear differences in brightness. Roots of differences make
faint texture count beside strong edges.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import sweep_shifts

Array = NDArray[np.float64]

LEAST_OFFSET = 1e-3  # view steps; what is nearer to the reference view is the reference view
PENALTY = 1e-4  # of all view_sets but the first, besides their preference


class Compared(NamedTuple):
    """One view at one disparity, [y, x] each."""

    view: int
    cost: Array
    inside: NDArray[np.bool_]  # it takes part
    nearest: tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and columns of the nearest pixels in the view


class Axis(NamedTuple):
    """Where the pixels of one axis come from when they are shifted."""

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
    """The view [y, x, c] at all shifted pixels."""
    rows = view[y.first] + y.share[:, None, None] * (view[y.second] - view[y.first])
    return rows[:, x.first] + x.share[:, None] * (rows[:, x.second] - rows[:, x.first])


def central_differences(values: Array) -> tuple[Array, Array]:
    """In x and in y, border pixels repeated."""
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2


class PlaneSweep:
    """The sweep over views of one light field."""

    def __init__(
        self,
        offsets: Array,
        view_sets: Array,
        first: float,
        step: float,
        count: int,
        scale: float,
        truncation: float,
        gradient_weight: float,
        gradient_truncation: float,
        softness: float,
        preference: float,
        tolerance: float,
        least: int,
    ) -> None:
        self._view_sets = view_sets != 0
        self._disparities = first + step * np.arange(count)
        self._shifts = sweep_shifts(offsets, first=first, step=step, count=count)
        self._others = np.flatnonzero(np.hypot(*offsets.T) > LEAST_OFFSET)
        self._scale, self._truncation = scale, truncation
        self._weight, self._gradient_truncation = gradient_weight, gradient_truncation
        self._softness, self._preference, self._tolerance, self._least = softness, preference, tolerance, least

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._image, self._recorded, self._valid = image, recorded, valid

    def by_view_sets(self, volume_out: Array) -> None:
        size = (len(self._view_sets), *self._image.shape[:2])
        for label, slice_out in enumerate(volume_out):
            sums, counts = np.zeros(size), np.zeros(size)
            for compared in self._compared(label, self._weight, self._truncation):
                members = self._view_sets[:, compared.view]
                sums[members] += np.where(compared.inside, compared.cost, 0)
                counts[members] += compared.inside
            means = np.where(counts > 0, sums / np.maximum(counts, 1), self._most(self._weight, self._truncation))
            means[1:] = means[1:] * (1 + self._preference) + PENALTY
            slice_out[:] = means.min(0)

    def by_visibility(self, nearest: Array, volume_out: Array, *, truncation: float | None = None) -> None:
        weight, truncation = (self._weight, self._truncation) if truncation is None else (0.0, truncation)
        for label, slice_out in enumerate(volume_out):
            total, count = np.zeros(slice_out.shape), np.zeros(slice_out.shape)
            for compared in self._compared(label, weight, truncation):
                surface = nearest[compared.view][compared.nearest]
                sees = compared.inside & (self._disparities[label] >= surface - self._tolerance)
                total += np.where(sees, compared.cost, 0)
                count += sees
            slice_out[:] = np.where(count >= self._least, total / np.maximum(count, 1), self._most(weight, truncation))

    def _most(self, weight: float, truncation: float) -> float:
        return float((self._rooted(truncation) + weight * self._gradient_truncation) / (1 + weight))

    def _rooted(self, difference: Array | float) -> Array | float:
        """As it is while it is small; beyond the softness it counts by its root."""
        s = self._softness
        return 2 * s * (np.sqrt(1 + difference / s) - 1) if s > 0 else difference

    def _compared(self, label: int, weight: float, truncation: float) -> Iterator[Compared]:
        """Each view but the reference; `weight` is that of gradients, `truncation` that of intensities."""
        height, width, _ = self._image.shape
        for n in self._others:
            x, y = shifted(width, self._shifts[label, n, 0]), shifted(height, self._shifts[label, n, 1])
            difference = self._scale * bilinear(self._recorded[n], x, y) - self._image
            color = np.abs(difference).mean(2)
            gradient = np.abs(np.concatenate(central_differences(difference), axis=2)).mean(2)
            robust = self._rooted(np.minimum(color, truncation))
            robust += weight * np.minimum(gradient, self._gradient_truncation)
            inside, nearest = np.outer(y.inside, x.inside), tuple(np.meshgrid(y.nearest, x.nearest, indexing="ij"))
            if self._valid is not None:
                inside &= self._valid[n][nearest] != 0
            yield Compared(int(n), robust / (1 + weight), inside, (nearest[0], nearest[1]))


def plane_sweep(
    shape: Sequence[int],
    offsets: Array,
    view_sets: Array,
    *,
    first: float,
    step: float,
    count: int,
    scale: float,
    truncation: float,
    gradient_weight: float,
    gradient_truncation: float,
    softness: float,
    preference: float,
    tolerance: float,
    least: int,
) -> PlaneSweep:
    return PlaneSweep(
        offsets,
        view_sets,
        first,
        step,
        count,
        scale,
        truncation,
        gradient_weight,
        gradient_truncation,
        softness,
        preference,
        tolerance,
        least,
    )
