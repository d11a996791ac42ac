"""Photometric bundle adjustment: places and directions of the cameras of a light field, found in their views.

Points of the reference view that have texture are looked up in all views. The residual of point p in view n is

    e_pn = V_n(H_n(p - d_p (o_n + δ_n))) - g_n T_p - b_n

with the recorded view V_n between its pixels (`Surface`), the offset o_n of its camera, and the unknowns: a homography
H_n from where the point should be to where it is recorded, a change δ_n of the camera's position, a gain g_n and an
offset b_n; and for each point its disparity d_p and its brightness T_p. Gauss-Newton steps with robust weights, of
single residuals and of points as a whole, solve for all of them at once: disparity and brightness of each point are
eliminated (Schur complement), so that a view that is out of line is not hidden by a map that follows it.

Steps do not reach views that are many pixels off: to robust weights all of such a view is an outlier. Where a view
fits much worse than the others, the whole pixels by which it is off are searched first, by the correlation of the
orientation of gradients (Fitch et al. 2002), and steps go on from there.

Views cannot tell the gauge: all of them moved alike, or in proportion to their offsets, which is another plane of
disparity 0. Weak priors decide it; they keep every unknown near its start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras import consensus
from lfgpu.cameras.points import Points, farthest
from lfgpu.cameras.surface import Surface, grey
from lfgpu.cameras.tones import squared_radius_at
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.windows import smoothed
from lfgpu.threads import in_threads

_GENERATORS = np.array(
    [
        ((0, 0, 1), (0, 0, 0), (0, 0, 0)),
        ((0, 0, 0), (0, 0, 1), (0, 0, 0)),
        ((0, -1, 0), (1, 0, 0), (0, 0, 0)),  # rotation, from x to y: clockwise as y is down
        ((1, 0, 0), (0, 1, 0), (0, 0, 0)),  # scale
        ((1, 0, 0), (0, -1, 0), (0, 0, 0)),
        ((0, 1, 0), (1, 0, 0), (0, 0, 0)),
        ((0, 0, 0), (0, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, 0, 0), (0, 1, 0)),
    ],
    np.float64,
)  # what each parameter of a homography adds to the identity, in units of the picture's half diagonal
MODELS = {"shift": 2, "similarity": 4, "homography": 8}
"""Kinds of homographies, and their number of parameters."""

_LEAST_NOISE = 0.003  # intensity
_MEMORY = 3e7  # numbers that couple views with points
_PRIOR_SHIFT = 3.0  # pixels: weak priors, see the head of this file
_PRIOR_SHAPE = 3.0  # pixels at the half diagonal
_PRIOR_POSITION = 0.1  # view steps
_PRIOR_GAIN, _PRIOR_OFFSET = 0.3, 0.1
_PRIOR_DISPARITY = 1.0  # pixels in the farthest view
_HALF = 0.7  # of the usual misfit: a point that fits as badly as that counts half
_LONGEST = 1.0  # pixels in the farthest view: bound of a step of disparity
_LONGEST_SHIFT = 2.0  # pixels: bound of a step of a view
_LEAST_GAIN = 1e-3
_SMOOTHED = 1.0  # pixels: standard deviation with which views are smoothed before their gradients are compared


def homographies(warps: Float64Array, size: tuple[int, int]) -> Float64Array:
    """Make homographies [n, 3, 3] of warps [n, k]: from where things should be to where they are, (x, y, 1) in pixels.

    `warps` are in units of the half diagonal, `size` is the (height, width) of the pictures.
    """
    height, width = size
    radius = float(np.hypot(*size)) / 2
    to = np.array([[1, 0, -(width - 1) / 2], [0, 1, -(height - 1) / 2], [0, 0, radius]]) / radius
    found = np.linalg.inv(to) @ (np.eye(3) + np.einsum("nk,kij->nij", warps, _GENERATORS[: warps.shape[1]])) @ to
    return np.asarray(found / found[:, 2:, 2:])


class Bundle:
    """Unknowns of all views and points of one light field, and steps that improve them.

    The homography of a view is of a kind: "shift", "similarity" or "homography". With `free_positions`, positions are
    unknown, too. Views are first smoothed by `smoothing` pixels, with which steps reach farther.
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
        self._generators = _GENERATORS[: MODELS[model]]
        self._middle = (np.array(lf.size[::-1]) - 1) / 2
        self.radius = float(np.hypot(*lf.size)) / 2
        self._reach = farthest(lf)
        count = len(lf.views)
        self.warps = np.zeros((count, len(self._generators)))
        """[n, k], parameters of the homographies, in units of the half diagonal (`radius`)."""
        self.shifted = np.zeros((count, 2))
        """[n, 2], change of each position, view steps."""
        self.tones = np.tile([1.0, 0.0], (count, 1))
        """[n, 2], gain and offset of each view against the reference."""
        self.disparity = points.disparity.copy()
        self._start = points.disparity.copy()
        self.noise = 0.0
        """Robust standard deviation of the residuals, intensity."""
        self.load(smoothing)
        self.brightness, *slopes = self._surfaces[lf.reference_index](points.x, points.y)
        self._slope = max(float(np.median(np.hypot(*slopes))), 1e-9)
        self.misfit = np.zeros(count)
        """[n], usual residual of each view over its usual gradient: pixels by which its edges seem to stand off."""
        self.influence: Float64Array = np.zeros((count, 0, 0))
        """[n, k + ..., t], move of each unknown of each view by each tile of the picture alone; set by `step`.

        The sum of squares over tiles is the variance of the unknown."""

    def load(self, smoothing: float) -> None:
        """Look at the views smoothed with a Gaussian of that standard deviation in pixels; 0 is as they are."""

        def surface(index: int) -> Surface:
            if smoothing:
                return Surface(smoothed(grey(self._lf, index), smoothing)[..., None])
            return Surface(self._lf.views[index], self._lf.scale)

        self._surfaces = in_threads(surface, range(len(self._lf.views)))

    # --- steps ---

    def run(self, iterations: int, *, tolerance: float = 1e-3) -> None:
        """Take up to so many steps; fewer if one moves no view by more than `tolerance` pixels.

        If views were far off, as many are taken from the place that was found for these.
        """
        for _ in range(2):
            for _ in range(iterations):
                if self.step() < tolerance:
                    break
            self._measure_misfit()
            if not self._find_far_views():
                break

    def step(self) -> float:
        """Take a Gauss-Newton step of all unknowns; returns the largest move of a view, pixels."""
        views, count = range(len(self._lf.views)), len(self.points.x)
        looks = in_threads(self._look, views)
        residuals = np.stack([look.residual for look in looks])
        seen = np.stack([look.weight for look in looks])
        self.noise = spread(residuals, seen)
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

    def look_up(self, index: int, channel: int) -> tuple[Float64Array, Float64Array]:
        """Look the points up in one colour of a view: its intensities, and their weights, both [p]."""
        x, y, inside = self._places(index, index, self.warps[index])[:3]
        one = Surface(self._lf.views[index, ..., channel : channel + 1], self._lf.scale)
        return one(x, y)[0], inside * self.points.visible[index]

    def squared_radii(self) -> Float64Array:
        """Squared distance [n, p] of each point from the middle of each view, half diagonals."""
        places = [np.stack(self._places(n, n, self.warps[n])[:2], axis=-1) for n in range(len(self._lf.views))]
        return np.stack([squared_radius_at(at, self._lf.size) for at in places])

    def places(self) -> NDArray[np.intp]:
        """Tell at the place of which camera each view [n] fits: at its own, but for exchanged ones.

        A view that fits badly where it stands is tried at the places of all others.
        """
        own, usual = np.arange(len(self.misfit)), self._usual_warps()
        found = own.copy()
        for n in self._unlike():
            elsewhere = [self._at(n, place, usual[place])[1] for place in range(len(own))]
            there = np.where(own == n, min(elsewhere), self.misfit)
            if not consensus.unlike(there, self._lf.offsets)[n]:
                found[n] = np.argmin(elsewhere)
        return found

    # --- views that are far off ---

    def _find_far_views(self) -> bool:
        """Let views that fit badly start where whole pixels make them fit better; False if there are none."""
        found, usual = False, self._usual_warps()
        for n in self._unlike():
            warp = usual[n].copy()
            warp[:2] += self._whole_pixels(n) / self.radius
            tones, misfit = self._at(n, n, warp)
            if misfit < self.misfit[n]:
                self.warps[n], self.tones[n], found = warp, tones, True
        return found

    def _unlike(self) -> list[int]:
        return [int(n) for n in np.flatnonzero(consensus.unlike(self.misfit, self._lf.offsets))]

    def _usual_warps(self) -> Float64Array:
        """Warps [n, k] of views that fit: what views cannot tell drifts, and takes all of them along."""
        usual = np.repeat(np.median(self.warps, axis=0, keepdims=True), len(self.warps), axis=0)
        usual[:, :2] = self.warps[:, :2] - consensus.without_gauge(self.warps[:, :2], self._lf.offsets)
        return usual

    def _whole_pixels(self, index: int) -> Float64Array:
        """Find the shift (x, y) with which most gradients of a view have the directions of those at the points."""
        (du, dv), (height, width) = self._lf.offsets[index], self._lf.size
        x = np.rint(self.points.x - self._start * du).astype(np.intp)  # by disparities that have not drifted yet
        y = np.rint(self.points.y - self._start * dv).astype(np.intp)
        seen = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (self.points.visible[index] > 0)
        own = self.points.y[seen].astype(np.intp), self.points.x[seen].astype(np.intp)
        wanted = np.zeros((height, width), np.complex64)
        np.add.at(wanted, (y[seen], x[seen]), _directions(grey(self._lf, self._lf.reference_index))[own])
        shown = np.fft.fft2(_directions(grey(self._lf, index)))
        alike = np.fft.ifft2(shown * np.fft.fft2(wanted).conj()).real
        down, right = np.unravel_index(np.argmax(alike), alike.shape)  # cyclic: more than half is the other way
        return np.array([(right + width // 2) % width - width // 2, (down + height // 2) % height - height // 2], float)

    def _at(self, index: int, place: int, warp: Float64Array) -> tuple[Float64Array, float]:
        """Fit gain and offset of a view with a warp at the place of a camera; returns them and the misfit."""
        x, y, inside = self._places(index, place, warp)[:3]
        seen = inside * self.points.visible[place] > 0
        if not seen.any():
            return self.tones[index], np.inf
        value = self._surfaces[index](x[seen], y[seen])[0]
        columns = np.stack([self.brightness, np.ones_like(x)], axis=1)[seen]
        rest = consensus.robust_rest(columns, value[:, None])[:, 0]
        tones = np.linalg.lstsq(columns, value - rest, rcond=None)[0]
        return tones, float(self._misfit(rest[None], np.ones((1, len(rest))), tones[None])[0])

    def _measure_misfit(self) -> None:
        looks = in_threads(self._look, range(len(self._lf.views)))
        residuals, seen = np.stack([look.residual for look in looks]), np.stack([look.weight for look in looks])
        self.misfit = self._misfit(residuals, seen, self.tones)

    def _misfit(self, residuals: Float64Array, seen: Float64Array, tones: Float64Array) -> Float64Array:
        """Usual residual of each view over its usual gradient, pixels, from residuals [n, p] with tones [n, 2]."""
        return spreads(residuals, seen) / (np.maximum(tones[:, 0], _LEAST_GAIN) * self._slope)

    # --- helpers ---

    def _places(
        self, index: int, place: int, warp: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array, Float64Array]:
        """Places (x, y) of the points in a view with a warp, where the camera `place` should see them, 1 for those in
        its frame, and their homogeneous coordinates."""
        du, dv = self._lf.offsets[place] + self.shifted[place]
        px = (self.points.x - self.disparity * du - self._middle[0]) / self.radius
        py = (self.points.y - self.disparity * dv - self._middle[1]) / self.radius
        h = np.eye(3) + np.einsum("k,kij->ij", warp, self._generators)
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
        x, y, inside, px, py, w = self._places(index, index, self.warps[index])
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
        """Distances of all parameters of all views from their priors, and precisions of these."""
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
    """View at all points: residual and weight [p], Jacobian [k, p], derivative by disparity [p]."""

    residual: Float64Array
    weight: Float64Array
    jacobian: Float64Array
    by_disparity: Float64Array


def _directions(picture: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Directions of the gradients of a picture [y, x]: complex numbers of length 1, or 0 where it is flat."""
    down, right = np.gradient(smoothed(picture, _SMOOTHED))
    gradient = (right + 1j * down).astype(np.complex64)
    return np.divide(gradient, np.abs(gradient), out=np.zeros_like(gradient), where=gradient != 0)


def spread(residuals: Float64Array, seen: Float64Array) -> float:
    """Estimate the standard deviation of the residuals [n, p] that count, robustly; 0.003 at least."""
    counted = np.abs(residuals[seen > 0])
    return max(_LEAST_NOISE, 1.4826 * consensus.median(counted)) if len(counted) else _LEAST_NOISE


def spreads(residuals: Float64Array, seen: Float64Array) -> Float64Array:
    """Estimate the standard deviation [n] of the residuals [n, p] of each view, as `spread`; 0.003 if none counts."""
    counted = np.sort(np.where(seen > 0, np.abs(residuals), np.inf), axis=1)
    counts = (seen > 0).sum(1)
    middle = counted[np.arange(len(counted)), np.maximum(counts - 1, 0) // 2]
    return np.maximum(_LEAST_NOISE, np.where(counts > 0, 1.4826 * middle, 0.0))


def _trust(residuals: Float64Array, weights: Float64Array) -> Float64Array:
    """Weights of the points [p]: lower where the views together fit worse than at most points.

    There the map has the wrong surface, such as the wall behind a thin bar, and no disparity near by explains them.
    """
    fit = np.sqrt((weights * residuals**2).sum(0) / np.maximum(weights.sum(0), 1e-12))
    return np.asarray(1 / (1 + (fit / max(_HALF * float(np.median(fit)), _LEAST_NOISE)) ** 4))


def most_points(views: int, columns: int) -> int:
    """Number of points that fit into memory, for views of `columns` unknowns each."""
    return int(np.clip(_MEMORY / (2 * views * columns), 500, 12000))
