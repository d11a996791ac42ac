"""Gain, offset and vignetting of each view against the reference, found at points that all of them show."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Float64Array

_ROUNDS = 12
_DARK, _BRIGHT = 0.01, 0.985  # intensity: what is less or more may have been cut off
_LEAST_NOISE = 0.003  # intensity
_FEWEST = 20  # points that a view must share with others


@dataclass(frozen=True, eq=False)
class Tones:
    """Tones of views: a view shows (gain + vignetting r²) t + offset where the reference would show t; each is [n, c].

    r is the distance from the middle of the view in units of its half diagonal.
    """

    gain: Float64Array
    offset: Float64Array
    vignetting: Float64Array

    def brightness(self, level: float | Float64Array) -> Float64Array:
        """Brightness [n, c] of each view where the reference shows the intensity `level`: a share."""
        return self.gain + self.offset / level

    def equalised(self, view: NDArray[np.float32], index: int, at: Float64Array) -> NDArray[np.float32]:
        """Give view `index` [y, x, c] in [0, 1] the tones of the reference; it shows the places `at` [y, x, 2]."""
        across = squared_radius_at(at, view.shape[:2])
        gain = self.gain[index] + self.vignetting[index] * across[..., None]
        return np.clip((view - self.offset[index]) / np.maximum(gain, 0.05), 0, 1).astype(np.float32)


def squared_radius_at(at: Float64Array, size: tuple[int, ...]) -> NDArray[np.float32]:
    """Squared distance [...] of places (x, y) [..., 2] from the middle of a view of `size`, half diagonals."""
    height, width = size
    x, y = at[..., 0] - (width - 1) / 2, at[..., 1] - (height - 1) / 2
    return np.asarray((x**2 + y**2) / (height**2 + width**2) * 4, np.float32)


def match_tones(
    shown: Float64Array, weight: Float64Array, radius2: Float64Array, reference: int, *, vignetting: bool
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Fit gain, offset and vignetting [n] of one colour to the intensities `shown` [n, p] of points.

    The intensity of a point is the mean of all views, so that noise of the reference alone does not lower the gains of
    others. Intensities and tones are found in turns, with robust weights; `weight` is 0 where a view does not show a
    point. `radius2` are squared distances from the middle of the view, half diagonals.
    """
    weight = weight * ((shown > _DARK) & (shown < _BRIGHT))
    count, both = len(shown), weight * weight[reference]
    light, expected = (both * shown).sum(1), (both * shown[reference]).sum(1)
    # A view of another exposure would be an outlier to robust weights that begin at equal light.
    gain = np.divide(light, expected, out=np.ones(count), where=expected > 0)
    offset, falloff = np.zeros(count), np.zeros(count)
    for _ in range(_ROUNDS):
        factor = gain[:, None] + falloff[:, None] * radius2
        total = (weight * factor**2).sum(0)
        like = (weight * factor * (shown - offset[:, None])).sum(0) / np.maximum(total, 1e-12)
        residual = shown - factor * like - offset[:, None]
        counted = np.abs(residual[weight > 0])
        noise = max(_LEAST_NOISE, 1.4826 * float(np.median(counted))) if len(counted) else _LEAST_NOISE
        robust = weight / (1 + (residual / (3 * noise)) ** 2) ** 2
        for n in range(count):
            kept = robust[n] > 0
            if kept.sum() < _FEWEST:
                continue
            columns = [like[kept], np.ones(int(kept.sum()))]
            if vignetting:
                columns.append(like[kept] * radius2[n, kept])
            a, w = np.stack(columns, 1), robust[n, kept]
            # A weak prior (as strong as one point of full contrast) keeps what texture does not tell at 1, 0 and 0.
            found = np.linalg.solve(
                (a * w[:, None]).T @ a + np.eye(a.shape[1]),
                (a * w[:, None]).T @ shown[n, kept] + _IDENTITY[: a.shape[1]],
            )
            gain[n], offset[n], falloff[n] = (*found, 0.0)[:3]
        # All against the reference: t' = g_r t + b_r is what it shows (its own vignetting cannot be told apart).
        g, b, v = gain[reference], offset[reference], falloff[reference]
        gain, falloff = gain / g, (falloff - gain * v / g) / g
        offset = offset - gain * b
    return gain, offset, falloff


_IDENTITY = np.array([1.0, 0.0, 0.0])
