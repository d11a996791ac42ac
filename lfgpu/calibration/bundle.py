"""Photometric bundle adjustment: where the cameras of a light field stand and look, from what their views show.

Points of the reference view that have texture are looked up in all views. The residual of point p in view n is

    e_pn = V_n(H_n(p - d_p (o_n + δ_n))) - g_n T_p - b_n

with the recorded view V_n between its pixels (`Surface`), the offset o_n of its camera, and the unknowns: a homography
H_n from where the point should be to where it is recorded, a change δ_n of the camera's position, a gain g_n and an
offset b_n; and for each point its disparity d_p and its brightness T_p. Gauss-Newton steps with robust weights, of
single residuals and of points as a whole, solve for all of them at once: disparity and brightness of each point are
eliminated (Schur complement), so that a view that is out of line is not hidden by a map that follows it.

What views cannot tell (the gauge: all of them moved alike, or in proportion to their offsets, which is another plane of
disparity 0) is decided by weak priors that keep every unknown near where it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import Device, Float64Array
from lfgpu.data.channels import mean_of_channels
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import eroded, gradient_size, smoothed, window_max, window_min
from lfgpu.threads import in_threads

MODELS: dict[str, tuple[tuple[tuple[float, ...], ...], ...]] = {
    "shift": (((0, 0, 1), (0, 0, 0), (0, 0, 0)), ((0, 0, 0), (0, 0, 1), (0, 0, 0))),
}
"""What each parameter of a view's homography adds to the identity, in units of the picture's half diagonal."""
MODELS["similarity"] = (
    *MODELS["shift"],
    ((0, -1, 0), (1, 0, 0), (0, 0, 0)),  # rotation, from x to y: clockwise as y is down
    ((1, 0, 0), (0, 1, 0), (0, 0, 0)),  # scale
)
MODELS["homography"] = (
    *MODELS["similarity"],
    ((1, 0, 0), (0, -1, 0), (0, 0, 0)),
    ((0, 1, 0), (1, 0, 0), (0, 0, 0)),
    ((0, 0, 0), (0, 0, 0), (1, 0, 0)),
    ((0, 0, 0), (0, 0, 0), (0, 1, 0)),
)

TOLERANCE = 1.2
"""Pixels in the farthest view: what is nearer by less hides nothing."""

_TILES = 12  # along the longer side: points are spread over them, and errors within one belong together
_LEAST_GRADIENT = 0.01  # intensity per pixel: less is no texture
_EDGE = 1.0  # pixels in the farthest view: where disparities around a point differ by more, it is left out
_LEAST_NOISE = 0.003  # intensity
_MEMORY = 3e7  # numbers that couple views with points
_AT_ONCE = 16  # views whose visibility is looked at together
_PRIOR_SHIFT = 3.0  # pixels: weak priors, see the head of this file
_PRIOR_SHAPE = 3.0  # pixels at the half diagonal
_PRIOR_POSITION = 0.1  # view steps
_PRIOR_GAIN, _PRIOR_OFFSET = 0.3, 0.1
_PRIOR_DISPARITY = 1.0  # pixels in the farthest view
_HALF = 0.7  # of the usual misfit: a point that fits as badly as that counts half
_LONGEST = 1.0  # pixels in the farthest view: bound of a step of disparity
_LONGEST_SHIFT = 2.0  # pixels: bound of a step of a view


@dataclass(frozen=True, eq=False)
class Points:
    """Points of the reference view that have texture and lie on smooth surfaces.

    Parameters
    ----------
    x, y
        float64 [p], columns and rows in pixels.
    disparity
        float64 [p], pixels per view step.
    visible
        float32 [n, p], 1 where a view sees the point, else 0.
    tile
        int [p], which part of the picture each lies in.
    """

    x: Float64Array
    y: Float64Array
    disparity: Float64Array
    visible: NDArray[np.float32]
    tile: NDArray[np.intp]


def grey(lf: LightField, index: int) -> NDArray[np.float32]:
    """The mean over colours of a view, float32 [y, x] in [0, 1]."""
    return mean_of_channels(lf.views[index], np.float32) * np.float32(lf.scale)


def farthest(lf: LightField) -> float:
    """How far the farthest camera stands from the reference, view steps."""
    return float(np.hypot(*lf.offsets.T).max())


def choose_points(lf: LightField, disparity: NDArray[np.floating], device: Device, *, most: int) -> Points:
    """Up to `most` points, those of the strongest gradients in each part of the reference view.

    `disparity` [y, x] is the reference's map; NaN is not known, and no point is taken there.
    """
    kernels = device.kernels
    height, width = lf.size
    known = np.isfinite(disparity)
    if lf.valid is not None:
        known &= lf.valid[lf.reference_index]
    far = float(np.nanmin(disparity)) if known.any() else 0.0
    map_ = np.where(known, disparity, far).astype(np.float32)
    y, x, tile = textured(lf, on_surface(lf, map_) & inner(known), most)
    visible = np.empty((len(lf.views), len(y)), np.float32)
    field = device.field(map_)
    for first in range(0, len(lf.views), _AT_ONCE):
        offsets = lf.offsets[first : first + _AT_ONCE]
        seen = device.zeros((len(offsets), height, width))
        kernels.visible(field, device.field(offsets), tolerance=TOLERANCE / farthest(lf), visible_out=seen)
        visible[first : first + _AT_ONCE] = kernels.numpy(seen)[:, y, x]
    return Points(x.astype(np.float64), y.astype(np.float64), map_[y, x].astype(np.float64), visible, tile)


def on_surface(lf: LightField, map_: NDArray[np.float32]) -> NDArray[np.bool_]:
    """[y, x], where no edge of depth is near by."""
    return window_max(map_, 5) - window_min(map_, 5) <= _EDGE / farthest(lf)


def inner(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """[y, x], what is known less a margin of three pixels."""
    return eroded(known, 3)


def textured(
    lf: LightField, usable: NDArray[np.bool_], most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Rows, columns and tiles of up to `most` pixels of the reference with texture, where they are usable [y, x]."""
    strength = gradient_size(smoothed(grey(lf, lf.reference_index), 0.7))
    side = max(lf.size) / _TILES
    rows, columns = np.nonzero(usable & (strength >= _LEAST_GRADIENT))
    tiles = (rows / side).astype(np.intp) * _TILES + (columns / side).astype(np.intp)
    share = max(1, most // max(1, len(np.unique(tiles))))
    order = np.lexsort((-strength[rows, columns], tiles))
    starts = np.searchsorted(tiles[order], np.unique(tiles))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff([*starts, len(order)]))
    # Of each part every third of the strongest three times as many: neighbours tell the same.
    kept = order[(rank < 3 * share) & (rank % 3 == 0)] if len(order) > most else order
    return rows[kept], columns[kept], tiles[kept]


class Surface:
    """A picture between its pixels, and its gradient: cubic B-splines with the pixels as coefficients.

    That smooths by 0.58 px. A spline through the pixels would not do: its noise is weaker halfway between pixels than
    on them, so that the sum of squares is least where views are looked up halfway, and noisy views drift there by up to
    0.1 px. Smoothed noise is nearly as strong everywhere.
    """

    def __init__(self, image: NDArray[np.float32]) -> None:
        self._height, self._width = image.shape
        self._padded = np.pad(image, 3, mode="reflect" if min(image.shape) > 3 else "edge")

    def __call__(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Value and derivatives by x and y at places [p]; those outside the frame are moved to its border."""
        x0, wx, sx = spline_weights(np.clip(x, 0, self._width - 1))
        y0, wy, sy = spline_weights(np.clip(y, 0, self._height - 1))
        stride = self._padded.shape[1]
        flat, corner = self._padded.ravel(), (y0 + 2) * stride + x0 + 2
        value, by_x, by_y = (np.zeros(len(x)) for _ in range(3))
        for j in range(4):
            row, slope = np.zeros(len(x)), np.zeros(len(x))
            for i in range(4):
                taken = flat[corner + (j * stride + i)]
                row += taken * wx[i]
                slope += taken * sx[i]
            value += row * wy[j]
            by_x += slope * wy[j]
            by_y += row * sy[j]
        return value, by_x, by_y


def spline_weights(at: Float64Array) -> tuple[NDArray[np.intp], list[Float64Array], list[Float64Array]]:
    """First of the four taps less one, their weights in the cubic B-spline, and the slopes of these."""
    whole = np.floor(at).astype(np.intp)
    t = at - whole
    s = 1 - t
    weights = [s**3 / 6, 2 / 3 - t * t * (1 - t / 2), 2 / 3 - s * s * (1 - s / 2), t**3 / 6]
    slopes = [-s * s / 2, t * (1.5 * t - 2), s * (2 - 1.5 * s), t * t / 2]
    return whole, weights, slopes


class Bundle:
    """The unknowns of all views and points of one light field, and steps that improve them.

    Parameters
    ----------
    lf
        The light field.
    points
        Where it is looked at.
    model
        What a view's homography may be: "shift", "similarity" or "homography".
    free_positions
        Whether positions of cameras are unknowns, too.
    smoothing
        Standard deviation, in pixels, of a Gaussian that views are smoothed with first: steps reach farther with it.
    """

    def __init__(
        self,
        lf: LightField,
        points: Points,
        *,
        model: str = "similarity",
        free_positions: bool = False,
        smoothing: float = 0.0,
    ) -> None:
        self._lf, self.points, self._free_positions = lf, points, free_positions
        self._generators = np.array(MODELS[model], np.float64)
        self._middle = (np.array(lf.size[::-1]) - 1) / 2
        self.radius = float(np.hypot(*lf.size)) / 2
        self._reach = farthest(lf)
        count = len(lf.views)
        self.warps = np.zeros((count, len(self._generators)))
        """[n, k], what each parameter of the model is, in units of the half diagonal (`radius`)."""
        self.shifted = np.zeros((count, 2))
        """[n, 2], change of each position, view steps."""
        self.tones = np.tile([1.0, 0.0], (count, 1))
        """[n, 2], gain and offset of each view against the reference."""
        self.disparity = points.disparity.copy()
        self._start = points.disparity.copy()
        self.noise = 0.0
        """Robust standard deviation of the residuals, intensity."""
        self.load(smoothing)
        self.brightness = self._surfaces[lf.reference_index](points.x, points.y)[0]
        self.influence: Float64Array = np.zeros((count, 0, 0))
        """[n, k + ..., t], by how much each tile of the picture alone would move each unknown of each view: the sum of
        squares over tiles is its variance. Set by `step`."""

    def load(self, smoothing: float) -> None:
        """Look at the views smoothed with a Gaussian of that standard deviation in pixels; 0 is as they are."""

        def surface(index: int) -> Surface:
            image = grey(self._lf, index)
            return Surface(smoothed(image, smoothing) if smoothing else image)

        self._surfaces = in_threads(surface, range(len(self._lf.views)))

    # --- what comes out ---

    @property
    def homographies(self) -> Float64Array:
        """[n, 3, 3], from where things should be to where they are recorded, (x, y, 1) in pixels."""
        normal = np.eye(3) + np.einsum("nk,kij->nij", self.warps, self._generators)
        to = np.array([[1, 0, -self._middle[0]], [0, 1, -self._middle[1]], [0, 0, self.radius]]) / self.radius
        found = np.linalg.inv(to) @ normal @ to
        return np.asarray(found / found[:, 2:, 2:])

    # --- steps ---

    def run(self, iterations: int, *, tolerance: float = 1e-3) -> None:
        """Up to so many steps; fewer if one moves no view by more than `tolerance` pixels."""
        for _ in range(iterations):
            if self.step() < tolerance:
                break

    def step(self) -> float:
        """One Gauss-Newton step of all unknowns; how far it moved a view at most, in pixels."""
        views, count = range(len(self._lf.views)), len(self.points.x)
        looks = in_threads(self._look, views)
        residuals = np.stack([look.residual for look in looks])
        seen = np.stack([look.weight for look in looks])
        self.noise = _spread(residuals, seen)
        weights = seen / (1 + (residuals / (3 * self.noise)) ** 2) ** 2 / self.noise**2
        weights *= _trust(residuals, weights)
        columns = looks[0].jacobian.shape[0]

        by_disparity = np.stack([look.by_disparity for look in looks])
        by_brightness = -np.repeat(self.tones[:, :1], count, axis=1)
        # Each point's 2 x 2 block, with its prior, as the Cholesky factor of its inverse.
        a = (weights * by_disparity**2).sum(0) + (self._reach / _PRIOR_DISPARITY) ** 2
        b = (weights * by_disparity * by_brightness).sum(0)
        c = (weights * by_brightness**2).sum(0) + 1e-6
        root_a = np.sqrt(a)
        low = b / root_a
        root_c = np.sqrt(np.maximum(c - low**2, 1e-9 * c))
        held = (self._reach / _PRIOR_DISPARITY) ** 2 * (self.disparity - self._start)
        score_d = (weights * by_disparity * residuals).sum(0) + held
        score_t = (weights * by_brightness * residuals).sum(0)
        first, second = score_d / root_a, (score_t - low * score_d / root_a) / root_c

        size = len(views) * columns
        coupled = np.empty((size, 2 * count), np.float32)
        normal, score = np.zeros((size, size)), np.zeros(size)
        tiles, places = np.unique(self.points.tile, return_inverse=True)
        by_tile = np.empty((size, len(tiles)))

        def add(n: int) -> None:
            jacobian, rows = looks[n].jacobian, slice(n * columns, (n + 1) * columns)
            weighted = jacobian * weights[n]
            normal[rows, rows] = weighted @ jacobian.T
            score[rows] = weighted @ residuals[n]
            left = weighted * by_disparity[n] / root_a
            right = (weighted * by_brightness[n] - left * low) / root_c
            coupled[rows, :count], coupled[rows, count:] = left, right
            parts = weighted * residuals[n] - left * first - right * second
            by_tile[rows] = [np.bincount(places, part, len(tiles)) for part in parts]

        in_threads(add, views)
        normal -= (coupled @ coupled.T).astype(np.float64)
        score -= coupled @ np.concatenate([first, second])
        state, precision = self._prior()
        normal[np.diag_indices(size)] += precision
        score += precision * state
        inverse = np.linalg.inv(normal)
        step = -(inverse @ score).reshape(len(views), columns)
        self.influence = (inverse @ by_tile).reshape(len(views), columns, len(tiles))
        moved = self._apply(step)
        back = np.concatenate([first, second]) + coupled.T @ step.ravel().astype(np.float32)
        second_step = -back[count:] / root_c
        first_step = (-back[:count] - low * second_step) / root_a
        longest = _LONGEST / self._reach
        self.disparity = self.disparity + np.clip(first_step, -longest, longest)
        self.brightness = self.brightness + second_step
        return moved

    def look_up(self, index: int, channel: int | None = None) -> tuple[Float64Array, Float64Array]:
        """What a view shows of each point, or one colour of it, and how much it counts, both [p]."""
        x, y, inside = self._places(index)[:3]
        if channel is None:
            return self._surfaces[index](x, y)[0], inside * self.points.visible[index]
        image = self._lf.views[index, ..., channel].astype(np.float32) * np.float32(self._lf.scale)
        return Surface(image)(x, y)[0], inside * self.points.visible[index]

    def squared_radii(self) -> Float64Array:
        """[n, p], squared distance of each point from the middle of each view, half diagonals."""
        places = [self._places(n)[:2] for n in range(len(self._lf.views))]
        return np.stack([((x - self._middle[0]) ** 2 + (y - self._middle[1]) ** 2) / self.radius**2 for x, y in places])

    # --- helpers ---

    def _places(
        self, index: int
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array, Float64Array]:
        """Where a view records the points (x, y), whether within the frame, and homogeneous coordinates before it."""
        du, dv = self._lf.offsets[index] + self.shifted[index]
        px = (self.points.x - self.disparity * du - self._middle[0]) / self.radius
        py = (self.points.y - self.disparity * dv - self._middle[1]) / self.radius
        h = np.eye(3) + np.einsum("k,kij->ij", self.warps[index], self._generators)
        w = h[2, 0] * px + h[2, 1] * py + h[2, 2]
        x = (h[0, 0] * px + h[0, 1] * py + h[0, 2]) / w * self.radius + self._middle[0]
        y = (h[1, 0] * px + h[1, 1] * py + h[1, 2]) / w * self.radius + self._middle[1]
        height, width = self._lf.size
        inside = ((x >= 1) & (x <= width - 2) & (y >= 1) & (y <= height - 2)).astype(np.float64)
        if self._lf.valid is not None:
            at = np.rint(y).clip(0, height - 1).astype(int), np.rint(x).clip(0, width - 1).astype(int)
            inside *= self._lf.valid[index][at]
        return x, y, inside, px, py, w

    def _look(self, index: int) -> _Look:
        x, y, inside, px, py, w = self._places(index)
        value, by_x, by_y = self._surfaces[index](x, y)
        gain, offset = self.tones[index]
        hx, hy = (x - self._middle[0]) / self.radius, (y - self._middle[1]) / self.radius
        jacobian = []
        for g in self._generators:
            gx, gy, gw = (g[i, 0] * px + g[i, 1] * py + g[i, 2] for i in range(3))
            jacobian.append((by_x * (gx - hx * gw) + by_y * (gy - hy * gw)) * self.radius / w)
        # The homography is the identity to first order: a change of the ideal place moves the recorded one as much.
        along_u, along_v = -by_x, -by_y
        du, dv = self._lf.offsets[index] + self.shifted[index]
        if self._free_positions:
            jacobian += [along_u * self.disparity, along_v * self.disparity]
        jacobian += [-self.brightness, np.full(len(x), -1.0)]
        residual = value - gain * self.brightness - offset
        return _Look(residual, inside * self.points.visible[index], np.stack(jacobian), along_u * du + along_v * dv)

    def _prior(self) -> tuple[Float64Array, Float64Array]:
        """What the priors hold, and how strongly, for all parameters of all views."""
        count, shape = self.warps.shape
        widths = np.full(shape, _PRIOR_SHAPE / self.radius)
        widths[:2] = _PRIOR_SHIFT / self.radius
        parts = [self.warps, *((self.shifted,) if self._free_positions else ()), self.tones - (1.0, 0.0)]
        sigma = [*widths, *((_PRIOR_POSITION,) * 2 if self._free_positions else ()), _PRIOR_GAIN, _PRIOR_OFFSET]
        precision = np.tile(1 / np.array(sigma) ** 2, (count, 1))
        precision[self._lf.reference_index, -2:] = 1e12  # the reference's brightness is what others are told against
        return np.concatenate(parts, axis=1).ravel(), precision.ravel()

    def _apply(self, step: Float64Array) -> float:
        shape = self.warps.shape[1]
        moved = np.abs(step[:, :shape]).max() * self.radius
        step = step * min(1.0, _LONGEST_SHIFT / max(float(moved), 1e-12))
        self.warps = self.warps + step[:, :shape]
        if self._free_positions:
            self.shifted = self.shifted + step[:, shape : shape + 2]
        self.tones = self.tones + step[:, -2:]
        return float(moved)


@dataclass(frozen=True, eq=False)
class _Look:
    """One view at all points: residual and weight [p], Jacobian [k, p], derivative by disparity [p]."""

    residual: Float64Array
    weight: Float64Array
    jacobian: Float64Array
    by_disparity: Float64Array


def _spread(residuals: Float64Array, seen: Float64Array) -> float:
    """Robust standard deviation of the residuals that count."""
    counted = np.abs(residuals[seen > 0])
    return max(_LEAST_NOISE, 1.4826 * float(np.median(counted))) if len(counted) else _LEAST_NOISE


def _trust(residuals: Float64Array, weights: Float64Array) -> Float64Array:
    """How much each point counts [p]: less where its views together fit worse than those of most points.

    There the map has the wrong surface, such as the wall behind a thin bar, and no disparity near by explains them.
    """
    fit = np.sqrt((weights * residuals**2).sum(0) / np.maximum(weights.sum(0), 1e-12))
    return np.asarray(1 / (1 + (fit / max(_HALF * float(np.median(fit)), _LEAST_NOISE)) ** 4))


def most_points(views: int, parameters: Sequence[object] | int) -> int:
    """How many points fit into memory."""
    columns = parameters if isinstance(parameters, int) else len(parameters)
    return int(np.clip(_MEMORY / (2 * views * columns), 500, 12000))
