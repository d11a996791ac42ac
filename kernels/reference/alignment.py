"""What comes near in each view, and Gauss-Newton on how well the views agree: NumPy, float64, one view at a time.

Views that show the same surface agree where the disparity is right. Colours alone leave faint texture and changes of
brightness undecided, so that their differences count too; what something nearer hides takes no part, and what does not
fit for another reason counts little.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
    """The maxima over the squares of side 2 radius + 1 that lie in `values`: smaller by `radius` on each side."""
    side = 2 * radius + 1
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, (side, side)).max(axis=(2, 3)))


class ZBuffer:
    def __init__(self, offsets: Array, reach: int) -> None:
        self._offsets, self._reach = offsets, reach

    def __call__(self, disparity: Array, nearest_out: Array) -> None:
        (height, width), border = disparity.shape, self._reach + 1
        for nearest, offset in zip(nearest_out, self._offsets, strict=True):
            front = np.full((height + 2 * border, width + 2 * border), NOWHERE)
            x, y = (rounded(place) + border for place in landing(disparity, offset))
            there = (x >= 0) & (x < front.shape[1]) & (y >= 0) & (y < front.shape[0])
            np.maximum.at(front, (y[there], x[there]), disparity[there])
            near = largest_around(front[1:-1, 1:-1], self._reach)
            nearest[:] = np.where(near > NOWHERE, near, largest_around(front, self._reach + 1))


def z_buffer(shape: Sequence[int], offsets: Array, *, reach: int) -> ZBuffer:
    return ZBuffer(offsets, reach)


def differences(values: Array) -> tuple[Array, Array]:
    """Central differences in x and y of [y, x, ..]; at the border they are others and not to be used."""
    return np.asarray(np.gradient(values, axis=1)), np.asarray(np.gradient(values, axis=0))


class Alignment:
    def __init__(self, offsets: Array, scale: float, gradient_weight: float, robust: float, tolerance: float) -> None:
        self._offsets, self._scale, self._gradient_weight = offsets, scale, gradient_weight
        self._robust, self._tolerance = robust, tolerance
        self._others = [n for n, offset in enumerate(offsets) if np.hypot(*offset) > AT_REFERENCE]

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        self._image = self._features(image)[BORDER:-BORDER, BORDER:-BORDER]
        self._recorded = recorded
        self._valid = np.ones(recorded.shape[:3]) if valid is None else valid

    def __call__(self, disparity: Array, nearest: Array, curvature_out: Array, slope_out: Array) -> None:
        seen = [self._seen(n, disparity, nearest[n]) for n in self._others]
        weights = [there * self._weight(features - self._image) for there, features, _ in seen]
        total = self._image + sum(k[..., None] * features for k, (_, features, _) in zip(weights, seen, strict=True))
        mean = total / sum(weights, np.ones(disparity.shape))[..., None]
        curvature_out[:], slope_out[:] = 0, 0
        for there, features, change in seen:
            k = there * self._weight(features - mean) / len(seen)
            curvature_out += k * (change**2).mean(2)
            slope_out -= k * (change * (features - mean)).mean(2)

    def _features(self, intensities: Array) -> Array:
        """Of an image [y, x, c] and what continues it beyond its border: [y + 6, x + 6, 3 c]."""
        continued = np.pad(intensities, ((BORDER, BORDER), (BORDER, BORDER), (0, 0)), mode="edge")
        across, down = differences(continued)
        return np.concatenate([continued, self._gradient_weight * across, self._gradient_weight * down], 2)

    def _weight(self, residual: Array) -> Array:
        return np.asarray(1 / (1 + (residual**2).mean(2) / self._robust**2) ** 2)

    def _seen(self, n: int, disparity: Array, nearest: Array) -> tuple[NDArray[np.bool_], Array, Array]:
        """Where view n takes part [y, x], its features and their derivatives [y, x, 3 c]; 0 beyond the frame."""
        (height, width), (du, dv) = disparity.shape, self._offsets[n]
        x, y = landing(disparity, self._offsets[n])
        there = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        pixel = rounded(y[there]), rounded(x[there])
        visible = there.copy()
        visible[there] = (self._valid[n][pixel] != 0) & (disparity[there] >= nearest[pixel] - self._tolerance)

        described = self._features(self._scale * self._recorded[n])
        across, down = differences(described)
        features, change = (np.zeros((height, width, described.shape[2])) for _ in range(2))
        features[there] = bilinear(described, x[there], y[there])
        change[there] = -bilinear(du * across + dv * down, x[there], y[there])
        return visible, features, change


def bilinear(values: Array, x: Array, y: Array) -> Array:
    """Values [p, c] of [y + 6, x + 6, c] at columns x and rows y [p] of what they continue."""
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    across, down = (x - left)[:, None], (y - top)[:, None]
    left, top = left + BORDER, top + BORDER
    above = (1 - across) * values[top, left] + across * values[top, left + 1]
    below = (1 - across) * values[top + 1, left] + across * values[top + 1, left + 1]
    return np.asarray((1 - down) * above + down * below)


def alignment(
    shape: Sequence[int],
    offsets: Array,
    *,
    scale: float,
    gradient_weight: float,
    robust: float,
    tolerance: float,
) -> Alignment:
    return Alignment(offsets, scale, gradient_weight, robust, tolerance)
