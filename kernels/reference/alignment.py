"""Nearest disparities in each view, and Gauss-Newton steps that align views: NumPy, float64, one view at a time.

Views that show the same surface agree where the disparity is right. Colours alone leave faint texture and changes of
brightness undecided, so that their differences count too; what something nearer hides takes no part, and what does not
fit for another reason counts little.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import GRADIENT_REACH, Float64Array as Array

from .edges import edge_weights

NOWHERE = -1e6  # the disparity of what nothing comes near
AT_REFERENCE = 1e-3  # view steps: what is no farther from the reference is the reference
BORDER = 3  # pixels beyond the frame that a bilinear mean of second differences looks at


def rounded(a: Array) -> NDArray[np.int64]:
    return np.floor(a + 0.5).astype(np.int64)


def landing(disparity: Array, offset: Array) -> tuple[Array, Array]:
    """Columns and rows [y, x] at which the reference pixels land in the view at `offset`."""
    rows, columns = np.mgrid[: disparity.shape[0], : disparity.shape[1]]
    return columns - disparity * offset[0], rows - disparity * offset[1]


def largest_around(values: Array, radius: int) -> Array:
    """Compute maxima over squares of side 2 radius + 1 that lie in `values`: smaller by `radius` on each side."""
    side = 2 * radius + 1
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, (side, side)).max(axis=(2, 3)))


class z_buffer:
    def __init__(self, size: Sequence[int], device: str, *, reach: int) -> None:
        pass

    def __call__(self, disparity: Array, offsets: Array, nearest_out: Array, *, reach: int) -> None:
        (height, width), border = disparity.shape, reach + 1
        for nearest, offset in zip(nearest_out, offsets, strict=False):
            if np.isnan(offset.sum()):
                continue
            front = np.full((height + 2 * border, width + 2 * border), NOWHERE)
            x, y = (rounded(place) + border for place in landing(disparity, offset))
            there = (x >= 0) & (x < front.shape[1]) & (y >= 0) & (y < front.shape[0])
            np.maximum.at(front, (y[there], x[there]), disparity[there])
            near = largest_around(front[1:-1, 1:-1], reach)
            nearest[:] = np.where(near > NOWHERE, near, largest_around(front, reach + 1))


def differences(values: Array) -> tuple[Array, Array]:
    """Central differences in x and y of [y, x, ..]; at the border they are others and not to be used."""
    return np.asarray(np.gradient(values, axis=1)), np.asarray(np.gradient(values, axis=0))


def features(intensities: Array) -> Array:
    """Unweighted features [y + 6, x + 6, 3 c] of an image [y, x, c] that goes on beyond its border."""
    continued = np.pad(intensities, ((BORDER, BORDER), (BORDER, BORDER), (0, 0)), mode="edge")
    return np.concatenate([continued, *differences(continued)], 2)


def mean_of(own: Array, of_views: Sequence[Array], weights: Sequence[Array]) -> Array:
    """Compute the mean of the reference [y, x, c], with weight 1, and of the views, with weights [y, x]."""
    total = own + sum(k[..., None] * found for k, found in zip(weights, of_views, strict=True))
    return np.asarray(total / sum(weights, np.ones(own.shape[:2]))[..., None])


class alignment:
    def __init__(
        self,
        shape: Sequence[int],
        offsets: Array,
        *,
        scale: float,
        gradient_weight: float,
        contrast: float,
        robust: float,
        tolerance: float,
        shared: Any = None,
    ) -> None:
        self._loaded = SimpleNamespace() if shared is None else shared._loaded
        self._offsets, self._scale, self._gradient_weight, self._contrast = offsets, scale, gradient_weight, contrast
        self._robust, self._tolerance = robust, tolerance
        self._others = [n for n, offset in enumerate(offsets) if np.hypot(*offset) > AT_REFERENCE]

    def room(self, stored: Any) -> int:
        return 0

    def load(self, image: Array, recorded: Array, valid: Array | None, room: Any = None) -> None:
        inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
        described = features(image)
        weights = np.empty(image.shape[:2])
        edge_weights(image, contrast=self._contrast, reach=GRADIENT_REACH, weights_out=weights)
        loaded = self._loaded
        loaded.weight_of_gradients = self._gradient_weight * weights
        loaded.image = self._weighted(described[inner])
        loaded.own_changes = [self._weighted(change[inner]) for change in differences(described)]
        loaded.recorded = recorded.copy()
        loaded.valid = np.ones(recorded.shape[:3]) if valid is None else valid

    def __call__(self, disparity: Array, nearest: Array, curvature_out: Array, slope_out: Array) -> None:
        own, own_changes = self._loaded.image, self._loaded.own_changes
        seen = [self._seen(n, disparity, nearest[n]) for n in self._others]
        weights = [there * self._weight(found - own) for there, found, *_ in seen]
        mean = mean_of(own, [found for _, found, _, _ in seen], weights)
        weights = [there * self._weight(found - mean) for there, found, *_ in seen]
        across = mean_of(own_changes[0], [change for _, _, change, _ in seen], weights)
        down = mean_of(own_changes[1], [change for _, _, _, change in seen], weights)
        curvature_out[:], slope_out[:] = 0, 0
        for n, k, (_, found, _, _) in zip(self._others, weights, seen, strict=True):
            change = -(self._offsets[n][0] * across + self._offsets[n][1] * down)
            curvature_out += k / len(seen) * (change**2).mean(2)
            slope_out -= k / len(seen) * (change * (found - mean)).mean(2)

    def _weighted(self, values: Array) -> Array:
        """Features [y, x, 3 c] or their changes, with the weight of gradients on theirs."""
        channels = values.shape[2] // 3
        return np.concatenate(
            [values[..., :channels], self._loaded.weight_of_gradients[..., None] * values[..., channels:]], 2
        )

    def _weight(self, residual: Array) -> Array:
        return np.asarray(1 / (1 + (residual**2).mean(2) / self._robust**2) ** 2)

    def _seen(self, n: int, disparity: Array, nearest: Array) -> tuple[NDArray[np.bool_], Array, Array, Array]:
        """Find the pixels [y, x] at which view n takes part, its features, and their changes in x and y [y, x, 3 c].

        Beyond the frame they are 0.
        """
        height, width = disparity.shape
        x, y = landing(disparity, self._offsets[n])
        there = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        pixel = rounded(y[there]), rounded(x[there])
        visible = there.copy()
        visible[there] = (self._loaded.valid[n][pixel] != 0) & (disparity[there] >= nearest[pixel] - self._tolerance)

        described = features(self._scale * self._loaded.recorded[n])
        found, across, down = (np.zeros((height, width, described.shape[2])) for _ in range(3))
        for values, out in zip((described, *differences(described)), (found, across, down), strict=True):
            out[there] = bilinear(values, x[there], y[there])
        return visible, self._weighted(found), self._weighted(across), self._weighted(down)


def bilinear(values: Array, x: Array, y: Array) -> Array:
    """Values [p, c] of [y + 6, x + 6, c] at columns x and rows y [p] of what they continue."""
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    across, down = (x - left)[:, None], (y - top)[:, None]
    left, top = left + BORDER, top + BORDER
    above = (1 - across) * values[top, left] + across * values[top, left + 1]
    below = (1 - across) * values[top + 1, left] + across * values[top + 1, left + 1]
    return np.asarray((1 - down) * above + down * below)
