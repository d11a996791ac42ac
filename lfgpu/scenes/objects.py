"""Surfaces in disparity space, and their intersections with rays.

Parallel cameras with shifted frames map 3D space projectively to *disparity space*: (x, y) of the pixel in the middle
view and disparity d. Rays stay straight lines and planes stay planes there; spheres become ellipsoids, and cuboids
become convex polyhedra. All coordinates are in *scene units*. (X, Y) have their origin in the image centre, and the
shorter side of the image is 1. T is 0 at the far end of the disparity range and 1 at the near end. The ray of a pixel
is { (x + T*U, y + T*V, T) }; all rays of a view have the same slope (U, V). A ray travels from large T to small T, so
that the first hit is the one with the largest T.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Rays:
    """A window of rays of one view: their positions `x` [1, w] and `y` [h, 1] at T = 0, and their slope (U, V)."""

    x: Floats
    y: Floats
    slope: tuple[float, float]


class Shape(Protocol):
    """A surface; all methods work in scene units."""

    def hit(self, rays: Rays) -> Floats:
        """Compute the largest T [h, w] at which each ray hits the surface; NaN for a miss."""

    def bounds(self, slope: tuple[float, float]) -> Bounds:
        """Return the bounds (left, right, top, bottom) at T = 0 of the rays of a slope that may hit the surface."""

    def normals(self, points: Floats) -> Floats:
        """Return vectors [3, k] or [3, 1] of any length that point out of the surface at its points [3, k]."""

    def moved(self, by: ArrayLike) -> Self:
        """Return the surface moved by (X, Y, T)."""


@dataclass(frozen=True, eq=False)
class _Framed:
    """A unit body under an affine map: p = centre + edges @ q, with q in the unit body.

    In q the ray is again a straight line, a + T*b, where b is one vector for all rays of a view.
    """

    centre: Floats
    edges: Floats
    inverse: Floats = field(init=False)

    _round: ClassVar[bool]  # whether the body is |q| <= 1 or max |q_i| <= 1
    _extent: ClassVar[int] = 3  # how many of the edges span it

    def __post_init__(self) -> None:
        object.__setattr__(self, "inverse", np.linalg.inv(self.edges))

    def bounds(self, slope: tuple[float, float]) -> Bounds:
        """See `Shape`."""
        along = np.array([[1.0, 0.0, -slope[0]], [0.0, 1.0, -slope[1]]])  # from points to where their rays pass T = 0
        x, y = along @ self.centre
        spread = along @ self.edges[:, : self._extent]
        half = np.sqrt((spread**2).sum(1)) if self._round else np.abs(spread).sum(1)
        return x - half[0], x + half[0], y - half[1], y + half[1]

    def moved(self, by: ArrayLike) -> Self:
        """See `Shape`."""
        return replace(self, centre=self.centre + np.asarray(by))

    def _local(self, rays: Rays) -> tuple[list[Floats], Floats]:
        """Return a [3][h, w] and b [3] of rays in the unit body's coordinates."""
        x, y, t = rays.x - self.centre[0], rays.y - self.centre[1], -self.centre[2]
        a = [row[0] * x + (row[1] * y + row[2] * t) for row in self.inverse]
        return a, self.inverse @ (*rays.slope, 1.0)


class Ellipsoid(_Framed):
    """The unit ball |q| <= 1: balls, ellipsoids, and rods if one edge is very long."""

    _round = True

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`."""
        (a0, a1, a2), (b0, b1, b2) = self._local(rays)
        bb = b0 * b0 + b1 * b1 + b2 * b2
        ab = a0 * b0 + a1 * b1 + a2 * b2
        discriminant = ab * ab - bb * (a0 * a0 + a1 * a1 + a2 * a2 - 1.0)
        with np.errstate(invalid="ignore"):  # NaN marks a miss
            return np.asarray((np.sqrt(discriminant) - ab) / bb)

    def normals(self, points: Floats) -> Floats:
        """See `Shape`."""
        return self.inverse.T @ (self.inverse @ (points - self.centre[:, None]))


class Box(_Framed):
    """The cube |q_i| <= 1: a parallelepiped, which is a convex body with six plane faces in 3D as well."""

    _round = False

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`."""
        near: Floats | float = np.inf
        far: Floats | float = -np.inf
        with np.errstate(divide="ignore", invalid="ignore"):  # a ray along a face: infinities do the right thing
            for a, b in zip(*self._local(rays), strict=True):
                side = np.copysign(1.0, b)  # of the face where the ray comes in; -0.0 has the other sign's infinities
                near = np.minimum(near, (side - a) / b)
                far = np.maximum(far, (-side - a) / b)
        return np.where(near >= far, near, np.nan)

    def normals(self, points: Floats) -> Floats:
        """See `Shape`."""
        q = self.inverse @ (points - self.centre[:, None])
        face = np.abs(q).argmax(0)
        towards = np.take_along_axis(q, face[None], axis=0)[0] > 0
        return np.concatenate([-self.inverse.T, self.inverse.T], axis=1)[:, face + 3 * towards]


@dataclass(frozen=True, eq=False)
class Frustum(_Framed):
    """The round body q_0² + q_2² <= (1 + taper q_1)², |q_1| <= 1: a cylinder if `taper` is 0, a pot or cup if not."""

    taper: float = 0.0

    _round = False

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`."""
        (a0, a1, a2), (b0, b1, b2) = self._local(rays)
        radius, grows = 1.0 + self.taper * a1, self.taper * b1
        bb = b0 * b0 + b2 * b2 - grows * grows
        ab = a0 * b0 + a2 * b2 - radius * grows
        with np.errstate(divide="ignore", invalid="ignore"):  # NaN marks a miss
            root = np.sqrt(ab * ab - bb * (a0 * a0 + a2 * a2 - radius * radius))
            side = np.copysign(1.0, b1)
            near, far = np.minimum((root - ab) / bb, (side - a1) / b1), np.maximum(-(root + ab) / bb, -(side + a1) / b1)
        return np.where(near >= far, near, np.nan)

    def normals(self, points: Floats) -> Floats:
        """See `Shape`."""
        q = self.inverse @ (points - self.centre[:, None])
        radius = 1.0 + self.taper * q[1]
        end = np.abs(q[1]) > 1.0 - 1e-9
        out = np.where(end, [[0.0], [1.0], [0.0]] * np.sign(q[1]), [q[0], -self.taper * radius, q[2]])
        return self.inverse.T @ out


class _Flat(_Framed):
    """A piece of the plane q_2 = 0; `edges` are two vectors in the plane and any third out of it."""

    _extent = 2

    def _cross(self, rays: Rays) -> tuple[Floats, Floats, Floats]:
        """Return T [h, w] where rays cross the plane, and q_0, q_1 there."""
        (a0, a1, a2), (b0, b1, b2) = self._local(rays)
        t = a2 / -b2
        return t, a0 + t * b0, a1 + t * b1

    def normals(self, points: Floats) -> Floats:
        """See `Shape`."""
        return (self.inverse[2] * np.sign(self.inverse[2, 2]))[:, None]  # the side that the cameras see


class Wall(_Flat):
    """The whole plane."""

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`."""
        return self._cross(rays)[0]

    def bounds(self, slope: tuple[float, float]) -> Bounds:
        """See `Shape`."""
        return -np.inf, np.inf, -np.inf, np.inf


class Quad(_Flat):
    """A parallelogram |q_0|, |q_1| <= 1."""

    _round = False

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`."""
        t, q0, q1 = self._cross(rays)
        return np.where((np.abs(q0) <= 1.0) & (np.abs(q1) <= 1.0), t, np.nan)


class Disc(_Flat):
    """An ellipse q_0² + q_1² <= 1."""

    _round = True

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`."""
        t, q0, q1 = self._cross(rays)
        return np.where(q0 * q0 + q1 * q1 <= 1.0, t, np.nan)


@dataclass(frozen=True, eq=False)
class Relief:
    """A smooth height field T = level + sum_i amplitude_i * sin(X*kx_i + Y*ky_i + phase_i).

    Each ray meets it exactly once as long as `steepness` stays below 1 for the slopes of all views. `waves` are [k, 4].
    """

    level: float
    waves: Floats

    def height(self, x: Floats, y: Floats) -> Floats:
        """Return T above the points (X, Y)."""
        return self.level + sum(a * np.sin(x * kx + y * ky + phase) for a, kx, ky, phase in self.waves)

    def steepness(self, slope: tuple[float, float]) -> float:
        """Return a bound on how much T grows along a ray of that slope (or smaller ones) when T grows by 1."""
        amplitude, kx, ky, _ = np.abs(self.waves.T)
        return float((amplitude * (kx * abs(slope[0]) + ky * abs(slope[1]))).sum())

    def hit(self, rays: Rays) -> Floats:
        """See `Shape`. Newton's method, to about 1e-12."""
        phases = [rays.x * kx + (rays.y * ky + phase) for _, kx, ky, phase in self.waves]
        speeds = self.waves[:, 1:3] @ rays.slope  # of each phase along the ray
        amplitudes = self.waves[:, 0]
        t = self._newton_single(phases, amplitudes, speeds)
        step = np.inf
        while step > 1e-6:  # each step here shrinks the error about a million times: after this one, below 1e-12
            value = t - self.level
            slope = np.ones(t.shape, np.float32)
            for phase, amplitude, speed in zip(phases, amplitudes, speeds, strict=True):
                at = phase + speed * t
                value -= amplitude * np.sin(at)
                slope -= np.float32(amplitude * speed) * np.cos(at.astype(np.float32))
            value /= slope
            t -= value
            step = float(np.abs(value).max())
        return t

    def _newton_single(self, phases: Sequence[Floats], amplitudes: Floats, speeds: Floats) -> Floats:
        """Find T to about 1e-6: single-precision sines cost a tenth."""
        single = [
            (phase.astype(np.float32), np.float32(amplitude), np.float32(speed))
            for phase, amplitude, speed in zip(phases, amplitudes, speeds, strict=True)
        ]
        t = np.full(phases[0].shape, self.level, np.float32)
        for _ in range(4):
            value = t - np.float32(self.level)
            slope = np.ones_like(t)
            for phase, amplitude, speed in single:
                at = phase + speed * t
                value -= amplitude * np.sin(at)
                slope -= (amplitude * speed) * np.cos(at)
            t -= value / slope
        return t.astype(np.float64)

    def bounds(self, slope: tuple[float, float]) -> Bounds:
        """See `Shape`."""
        return -np.inf, np.inf, -np.inf, np.inf

    def normals(self, points: Floats) -> Floats:
        """See `Shape`."""
        normal = np.ones_like(points)
        normal[:2] = 0.0
        for amplitude, kx, ky, phase in self.waves:
            down = amplitude * np.cos((points[0] * kx + points[1] * ky + phase).astype(np.float32))
            normal[0] -= kx * down
            normal[1] -= ky * down
        return normal

    def moved(self, by: ArrayLike) -> Self:
        """See `Shape`."""
        x, y, t = np.asarray(by)
        waves = self.waves.copy()
        waves[:, 3] -= waves[:, 1] * x + waves[:, 2] * y
        return replace(self, level=self.level + t, waves=waves)
